"""Where the sockets are, and what is wrong with a run folder."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from common.bus import Endpoints, OrderServer, default_run_folder, is_local
from common.config.models import NetworkConfig
from common.errors import ConfigError
from common.messages import StoreSideOrder
from tests.support.hygiene import Place


def test_the_environment_wins_and_moves_all_sockets_into_the_run_folder(place: Place) -> None:
    found = Endpoints.of(NetworkConfig(prefix="other"))
    assert found.prefix == place.prefix
    assert found.run_dir == place.run_dir
    addresses = (found.publish, found.subscribe, found.orders_store, found.orders_label(3), found.command)
    assert all(address.startswith(f"ipc://{place.run_dir}/") for address in addresses)
    assert len(set(addresses)) == len(addresses)


def test_the_default_prefix_keeps_the_command_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TAGMILL_PREFIX", "tagmill")
    assert Endpoints.of(NetworkConfig(command="tcp://127.0.0.1:5999")).command == "tcp://127.0.0.1:5999"


def test_the_rigs_prefix_counts_without_the_environments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TAGMILL_PREFIX")
    assert Endpoints.of(NetworkConfig(prefix="b")).prefix == "b"


def test_the_default_run_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("TAGMILL_RUN_DIR")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert default_run_folder() == tmp_path / "tagmill"
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "missing"))
    assert default_run_folder() == Path(f"/tmp/tagmill-{os.getuid()}")


@pytest.mark.parametrize("prefix", ["..", "a/b"])
def test_a_prefix_can_not_leave_the_folder(monkeypatch: pytest.MonkeyPatch, prefix: str) -> None:
    monkeypatch.setenv("TAGMILL_PREFIX", prefix)
    with pytest.raises(ConfigError, match="leave the run folder"):
        Endpoints.of(NetworkConfig())


def test_a_path_too_long_for_a_socket_says_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TAGMILL_RUN_DIR", "/tmp/" + "x" * 90)
    with pytest.raises(ConfigError, match="TAGMILL_RUN_DIR"):
        Endpoints.of(NetworkConfig())


def test_the_longest_allowed_path_can_really_be_bound(monkeypatch: pytest.MonkeyPatch, place: Place) -> None:
    longest = "supervisor.sock.4194304"  # supervisord binds under this name, with its process id
    room = 107 - len(f"{place.run_root}//{longest}")
    monkeypatch.setenv("TAGMILL_PREFIX", "x" * room)
    endpoints = Endpoints.of(NetworkConfig())
    endpoints.prepare()
    OrderServer(endpoints.ipc(longest), StoreSideOrder).close()
    monkeypatch.setenv("TAGMILL_PREFIX", "x" * (room + 1))
    with pytest.raises(ConfigError, match="108 bytes"):
        Endpoints.of(NetworkConfig())


def test_the_run_folder_is_made_for_us_alone(place: Place) -> None:
    place.run_dir.mkdir(parents=True, mode=0o755)
    place.run_dir.chmod(0o755)
    Endpoints.of(NetworkConfig()).prepare()
    assert stat.S_IMODE(place.run_dir.stat().st_mode) == 0o700


def test_a_file_where_the_run_folder_should_be(place: Place) -> None:
    place.run_root.write_text("")
    with pytest.raises(ConfigError, match="is a file"):
        Endpoints.of(NetworkConfig()).prepare()
    place.run_root.unlink()


def test_a_link_where_the_run_folder_should_be(place: Place, tmp_path: Path) -> None:
    place.run_root.mkdir()
    place.run_dir.symlink_to(tmp_path)
    with pytest.raises(ConfigError, match="is a link"):
        Endpoints.of(NetworkConfig()).prepare()


def test_a_run_folder_of_another_user(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    place.run_dir.mkdir(parents=True)
    mine = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: mine + 1)
    with pytest.raises(ConfigError, match=f"belongs to user {mine}"):
        Endpoints.of(NetworkConfig()).prepare()


@pytest.mark.parametrize(
    ("address", "local"),
    [
        ("ipc:///tmp/x", True),
        ("tcp://127.0.0.1:5750", True),
        ("tcp://127.3.2.1:5750", True),
        ("tcp://localhost:5750", True),
        ("tcp://[::1]:5750", True),
        ("tcp://*:5750", False),
        ("tcp://0.0.0.0:5750", False),
        ("tcp://192.168.1.5:5750", False),
        ("tcp://rig.example:5750", False),
        ("tcp://eth0:5750", False),
        # What is written in a way that isn't understood counts as open: it costs keys, not safety.
        ("tcp://127.1:5750", False),
        ("tcp://2130706433:5750", False),
        ("tcp://lo:5750", False),
        ("tcp://127.0.0.1:1;192.168.1.5:5750", False),
        ("tcp://[::ffff:192.168.1.5]:5750", False),
        ("tcp://[::]:5750", False),
        ("tcp://127.0.0.1.rig.example:5750", False),
    ],
)
def test_what_only_this_machine_reaches(address: str, local: bool) -> None:
    assert is_local(address) is local
