"""What is installed for real: logs that end, a supervisor that no other user reaches, a unit with few rights."""

from __future__ import annotations

import configparser
from pathlib import Path

import pytest

from common.bus import Endpoints
from common.config import load_rig
from common.config.models import NetworkConfig
from tests.support.stack import write_rig
from tools.stack.programs import supervisor_config

ROOT = Path(__file__).resolve().parents[2]


def read(text: str) -> configparser.RawConfigParser:
    parser = configparser.RawConfigParser(inline_comment_prefixes=(";",))
    parser.read_string(text)
    return parser


@pytest.fixture(params=["by hand", "by up", "a further camera"])
def supervisor(request: pytest.FixtureRequest, tmp_path: Path) -> configparser.RawConfigParser:
    if request.param == "by hand":
        return read((ROOT / "deploy/supervisord.conf").read_text())
    if request.param == "a further camera":
        return read((ROOT / "deploy/examples/conf.d/capture-cam1.conf").read_text())
    return read(supervisor_config(load_rig(write_rig(tmp_path)), Endpoints.of(NetworkConfig())))


def test_every_log_is_rotated(supervisor: configparser.RawConfigParser) -> None:
    programs = [name for name in supervisor.sections() if name.startswith("program:")]
    assert programs
    for name in programs:
        assert supervisor[name]["stdout_logfile_maxbytes"] == "10MB"
        assert supervisor[name]["stdout_logfile_backups"] == "3"
        assert supervisor[name]["redirect_stderr"] == "true"
    if supervisor.has_section("supervisord"):
        assert supervisor["supervisord"]["logfile_maxbytes"] == "10MB"


def test_the_supervisor_is_reached_by_its_user_only(supervisor: configparser.RawConfigParser) -> None:
    assert not supervisor.has_section("inet_http_server")
    if supervisor.has_section("unix_http_server"):
        assert supervisor["unix_http_server"]["chmod"] == "0700"


def test_the_unit_gives_few_rights() -> None:
    text = (ROOT / "deploy/systemd/tagmill.service").read_text()
    for line in (
        "NoNewPrivileges=yes",
        "CapabilityBoundingSet=",
        "ProtectSystem=strict",
        "ReadWritePaths=/dev/shm",
        "SystemCallFilter=@system-service",
        "RuntimeDirectoryMode=0700",
        "DevicePolicy=closed",
    ):
        assert f"\n{line}\n" in text, line
    assert "\nUser=root" not in text
