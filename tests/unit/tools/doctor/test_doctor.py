"""`tagmill doctor`: what is wrong with a machine is found, and each finding says what to do."""

from __future__ import annotations

import json
import resource
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from typing import Any

import pytest

from common.bus import Endpoints, NameLock, create_keys
from common.config import load_rig
from common.config.models import NetworkConfig, RigConfig
from common.frames.segment import Segment, segment_name
from tests.support.hygiene import Place
from tests.support.mounts import small_disk
from tests.support.stack import RIG, write_rig
from tools.cli import main
from tools.doctor import disk, doors, memory, software
from tools.doctor.finding import Finding

Told = Callable[..., dict[str, Finding]]


def told(check: Callable[..., Iterator[Finding]], rig: Path | None = None) -> dict[str, Finding]:
    found = {one.about: one for one in check(None if rig is None else load_rig(rig))}
    assert all(bool(one.cure) == (one.level != "good") for one in found.values()), found
    return found


def test_a_good_machine_is_told_so_in_words_and_in_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = write_rig(tmp_path)
    assert main(["doctor", "--rig", str(rig), "--json"]) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    levels = {one["about"]: one["level"] for one in document["findings"]}
    assert document["ok"] is True
    assert levels["rig"] == levels["packages"] == levels["OpenCV"] == levels["run folder"] == "good"
    assert {"shared memory", "disk", "disk speed", "clock", "leftovers", "addresses", "driver webcam"} <= levels.keys()
    assert not (tmp_path / "dataset").exists(), "looking makes nothing"


def test_a_rig_that_can_t_be_used_is_the_first_finding(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "rig.yaml").write_text("objects: 3\n")
    assert main(["doctor", "--rig", str(tmp_path / "rig.yaml"), "--json"]) == 5
    first = json.loads(capsys.readouterr().out)["findings"][0]
    assert (first["about"], first["level"]) == ("rig", "bad")
    assert "tagmill check" in first["cure"]


def test_the_extras_are_those_of_the_package_and_told_by_what_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert software.EXTRAS.keys() == set(metadata("tagmill").get_all("Provides-Extra") or ()) - {"dev"}
    there = {"fpng": "0.1.0", "isal": "1.7.0", "av": "1.0"}

    def version(name: str) -> str:
        if name not in there:
            raise PackageNotFoundError(name)
        return there[name]

    monkeypatch.setattr(software, "version", version)
    found = told(software.extras)["extras"].found
    assert found.startswith("installed: fast; not: ")
    assert "video (" in found, "too old a version is none"
    del there["isal"]
    assert told(software.extras)["extras"].found.startswith("installed: none; ")


def test_too_little_shared_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = write_rig(tmp_path, RIG.replace("width: 320, height: 240", "width: 1280, height: 720"))
    with small_disk(tmp_path / "shm", 8) as folder:
        monkeypatch.setenv("TAGMILL_SHM_DIR", str(folder))
        found = told(memory.shared_memory, rig)["shared memory"]
    assert found.level == "bad"
    assert "--shm-size=128m" in found.cure


def test_what_the_rings_take_is_what_deploy_readme_says() -> None:
    config = RigConfig.model_validate({"cameras": {"a": {"driver": "x", "width": 1280, "height": 720}}})
    assert round(memory.ring_bytes(config) / 1e6) == 350


def test_low_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (64, 128))
    found = told(memory.limits)
    assert {one.level for one in found.values()} == {"warning"}
    assert "ulimit -n 1024" in found["open files (ulimit -n)"].cure


def test_what_a_killed_stack_left_and_one_that_runs(place: Place) -> None:
    assert told(memory.leftovers)["leftovers"].found == "none"
    Endpoints.of(NetworkConfig()).prepare()
    (place.run_dir / "store.lock").write_text("store (pid 1)")
    found = told(memory.leftovers)["leftovers"]
    assert (found.level, "store.lock" in found.found, "tagmill down" in found.cure) == ("warning", True, True)
    assert (place.run_dir / "store.lock").exists(), "looking removes nothing"
    (place.run_dir / "store.lock").unlink()
    with Segment.create(segment_name(place.prefix, "cam0", "0badc0de"), 4096):
        assert told(memory.leftovers)["leftovers"].found == "none", "its owner lives"
    with NameLock(place.run_dir / "control.lock", "control"):
        assert "a stack runs" in told(memory.leftovers)["leftovers"].found


def test_a_dataset_that_can_t_be_written(tmp_path: Path) -> None:
    rig = write_rig(tmp_path)
    with small_disk(tmp_path / "dataset", 0.01) as folder:
        found = told(disk.dataset, rig)
        assert found["disk"].level == "warning"
        assert list(folder.iterdir()) == []
    assert found["disk speed"].level == "bad"


@contextmanager
def taken_port() -> Iterator[int]:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        yield other.getsockname()[1]


def test_an_address_that_another_program_holds(tmp_path: Path) -> None:
    with taken_port() as port:
        rig = write_rig(tmp_path, RIG + f"network: {{console: 'http://127.0.0.1:{port}'}}\n")
        found = told(doors.ports, rig)["addresses"]
    assert (found.level, str(port) in found.found) == ("bad", True)
    assert "network.console" in found.cure


def test_a_stack_of_another_prefix_needs_no_port_for_its_console(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TAGMILL_PREFIX", "another")
    assert told(doors.ports, write_rig(tmp_path))["addresses"].found.endswith("the console takes any free port")
    without = write_rig(tmp_path, RIG + "network: {console: null}\n")
    assert told(doors.ports, without)["addresses"].found.endswith("no console is wanted")


def test_keys_that_others_can_read(tmp_path: Path) -> None:
    create_keys(tmp_path / "keys")
    rig = write_rig(tmp_path, RIG + "network: {command: 'tcp://192.0.2.1:5750', keys: keys, console: null}\n")
    assert told(doors.ports, rig)["keys"].found == "1 client may use the command socket"
    (tmp_path / "keys" / "server.key_secret").chmod(0o644)
    found = told(doors.ports, rig)["keys"]
    assert (found.level, "chmod 600" in found.found) == ("bad", True)


def test_a_clock_that_was_never_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("common.clock.wall_ns", lambda: 86_400 * 10**9)
    assert told(software.clocks)["clock"].level == "bad"


def test_a_package_of_the_wrong_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(software, "requires", lambda _: ["numpy<1", "no-such-package", "rich; extra == 'x'"])
    found = told(software.versions)["packages"]
    assert found.level == "bad"
    assert "no-such-package is missing" in found.found
    assert "numpy is" in found.found
