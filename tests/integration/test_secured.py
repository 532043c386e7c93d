"""A stack's doors: what is bound where, who may open what, and CURVE on the command socket of a real control."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import msgpack
import psutil
import pytest
import zmq
import zmq.auth

from common.bus import CommandClient, add_client, create_keys
from common.errors import EXIT_BAD_CONFIG, NoAnswerError
from tests.support.ports import free_port
from tests.support.stack import RIG, Stack, wait_for, write_rig

pytestmark = pytest.mark.process

REFUSED = "commands.client_refused"


def test_nothing_is_open_to_other_users_or_machines(stack: Stack, tmp_path: Path) -> None:
    rig = write_rig(tmp_path)
    running = [stack.start_service("control", rig), stack.start_service("capture", rig, "--camera", "cam0")]
    running.append(stack.start_service("console", rig))
    for process in running:
        process.wait_for_event("service.opened")
    segments = wait_for(lambda: list(Path("/dev/shm").glob(f"tagmill-{stack.place.prefix}-*")), why="a ring")
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in segments}
    assert set(modes.values()) == {0o600}, modes
    folder = stack.endpoints.run_dir
    assert (stat.S_IMODE(folder.stat().st_mode), folder.stat().st_uid) == (0o700, os.getuid())
    secret = [path for path in folder.iterdir() if "token" in path.name]
    assert all(stat.S_IMODE(path.stat().st_mode) == 0o600 for path in secret)
    listening = [
        one.laddr.ip
        for process in running
        for one in psutil.Process(process.pid).net_connections("inet")
        if one.status == psutil.CONN_LISTEN
    ]
    assert listening, "the console listens"
    assert set(listening) <= {"127.0.0.1", "::1"}


@pytest.fixture
def address(monkeypatch: pytest.MonkeyPatch) -> str:
    """A free port on a second loopback address. Only a stack of the default prefix has its command socket on tcp."""
    return f"tcp://127.0.0.2:{free_port('127.0.0.2')}"


def asked(address: str, server: bytes | None, own: tuple[bytes, bytes] | None, wait_ms: int) -> bytes | None:
    """What a client of plain pyzmq with these keys is told; None for nothing."""
    client = zmq.Context.instance().socket(zmq.DEALER)
    client.linger = 0
    try:
        if server is not None and own is not None:
            client.curve_serverkey = server
            client.curve_publickey, client.curve_secretkey = own
        client.connect(address)
        client.send(msgpack.packb({"command": "help"}))
        return client.recv() if client.poll(wait_ms) else None
    finally:
        client.close(linger=0)


def test_curve_end_to_end(stack: Stack, tmp_path: Path, address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = tmp_path / "keys"
    create_keys(keys)
    _, secret, _ = add_client(keys, "laptop")
    rig = write_rig(tmp_path, RIG + f"network: {{command: '{address}', keys: keys, console: null}}\n")
    # The default prefix is what puts the socket on tcp; the run folder is the test's own all the same.
    process = stack.start_service("control", rig, TAGMILL_PREFIX="tagmill")
    try:
        process.wait_for_event("service.opened")
        server = zmq.auth.load_certificate(keys / "server.key")[0]
        laptop = zmq.auth.load_certificate(secret)
        assert laptop[1] is not None
        own = (laptop[0], laptop[1])
        with CommandClient(address, keys_dir=keys) as client:
            assert client.request({"command": "help"}, timeout_s=30)["ok"] is True
        assert asked(address, server, own, 30_000) is not None, "another client that is on the list"
        assert asked(address, None, None, 500) is None, "no key"
        assert asked(address, own[0], own, 500) is None, "a wrong server key"
        assert asked(address, server, zmq.curve_keypair(), 500) is None, "a key that is not on the list"
        (keys / "authorized" / "laptop.key").unlink()
        assert asked(address, server, own, 500) is None, "a key that was taken off the list"
        with CommandClient(address) as plain, pytest.raises(NoAnswerError):
            plain.request({"command": "help"}, timeout_s=0.5)

        def reasons() -> dict[str, str] | None:
            told = {event["reason"]: event["address"] for event in process.events(REFUSED)}
            return told if len(told) >= 2 else None

        told = wait_for(reasons, why=f"both kinds of refusal in the log: {process.log()}")
        assert told["its key is not in authorized/"] == "127.0.0.1"
        assert "it has no key, or not this server's" in told
        assert len(process.events(REFUSED)) < 20, "a client that tries ten times a second doesn't fill the log"
        assert psutil.pid_exists(process.pid)
    finally:
        assert process.stop() == 0


def test_off_loopback_without_keys_it_does_not_start(stack: Stack, tmp_path: Path) -> None:
    rig = write_rig(tmp_path, RIG + "network: {command: 'tcp://192.0.2.1:5750', console: null}\n")
    process = stack.start_service("control", rig, TAGMILL_PREFIX="tagmill")
    assert process.wait(30) == EXIT_BAD_CONFIG
    assert "CURVE keys" in process.log()
