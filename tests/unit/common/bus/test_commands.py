"""The command socket: five lines of pyzmq are enough, and whoever isn't known stays outside."""

from __future__ import annotations

import socket
import stat
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import msgpack
import pytest
import zmq
import zmq.auth

from common.bus import CommandClient, CommandServer, Endpoints, Poller, add_client, create_keys
from common.bus.commands import MAX_REQUEST_BYTES
from common.errors import CodecError, ConfigError, NameTakenError, NoAnswerError, RefusedError
from common.messages import unpack
from tests.support.ports import free_port


@pytest.fixture
def tcp(endpoints: Endpoints) -> Endpoints:
    return replace(endpoints, command=f"tcp://127.0.0.1:{free_port()}")


@contextmanager
def serving(endpoints: Endpoints, keys: Path | None = None) -> Iterator[CommandServer]:
    """A server that answers each map with itself."""
    server = CommandServer(endpoints, keys)
    over = threading.Event()

    def serve() -> None:
        poller = Poller(server)
        while not over.is_set():
            poller.wait(0.05)
            for back, data in server.receive():
                try:
                    server.answer(back, {"ok": True, "you_said": unpack(data)})
                except CodecError as error:
                    server.answer(back, {"ok": False, "error": {"code": error.code, "message": error.message}})

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield server
    finally:
        over.set()
        thread.join(5)
        server.close()


def plain_socket(kind: int, address: str) -> zmq.Socket[bytes]:
    made = zmq.Context.instance().socket(kind)
    made.linger = 0
    made.rcvtimeo = 5000
    made.connect(address)
    return made


def test_a_plain_req_socket_is_served(tcp: Endpoints) -> None:
    with serving(tcp), closing(plain_socket(zmq.REQ, tcp.command)) as client:
        client.send(msgpack.packb({"command": "status"}))
        assert msgpack.unpackb(client.recv()) == {"ok": True, "you_said": {"command": "status"}}


def test_req_with_request_ids_is_served(tcp: Endpoints) -> None:
    with serving(tcp), closing(plain_socket(zmq.REQ, tcp.command)) as client:
        client.setsockopt(zmq.REQ_CORRELATE, 1)
        client.send(msgpack.packb({"command": "status"}))
        assert msgpack.unpackb(client.recv())["ok"] is True


@pytest.mark.parametrize("envelope", [[], [b""], [b"id", b""], [b"a", b"b", b""]])
def test_a_dealer_gets_its_own_framing_back(tcp: Endpoints, envelope: list[bytes]) -> None:
    with serving(tcp), closing(plain_socket(zmq.DEALER, tcp.command)) as client:
        client.send_multipart([*envelope, msgpack.packb({"command": "help"})])
        *back, body = client.recv_multipart()
        assert back == envelope
        assert msgpack.unpackb(body)["ok"] is True


def test_a_request_in_parts_is_an_error(tcp: Endpoints) -> None:
    with serving(tcp) as server, closing(plain_socket(zmq.DEALER, tcp.command)) as client:
        client.send_multipart([b"half", b"other half"])
        assert msgpack.unpackb(client.recv())["error"]["code"] == "bad_request"
        assert server.bad == 1


@pytest.mark.parametrize("where", ["ipc", "tcp"])
def test_answers_given_before_the_end_still_arrive(endpoints: Endpoints, tcp: Endpoints, where: str) -> None:
    chosen = tcp if where == "tcp" else endpoints
    server = CommandServer(chosen, None)
    asking = zmq.Context.instance().socket(zmq.DEALER)
    asking.setsockopt(zmq.RCVHWM, 1)  # so that most answers are still at the server when it closes
    asking.rcvtimeo, asking.linger = 5000, 0
    with closing(asking):
        asking.connect(chosen.command)
        asking.send(b"all")
        poller = Poller(server)
        requests = []
        while not requests:
            assert poller.wait(5.0)
            requests = server.receive()
        for number in range(6):
            server.answer(requests[0][0], {"number": number, "much": bytes(2_000_000)})
        server.close()
        assert [unpack(asking.recv(), 4 << 20)["number"] for _ in range(6)] == list(range(6))


@pytest.mark.parametrize("garbage", [b"", b"\xc1", b"GET / HTTP/1.1\r\n\r\n", msgpack.packb({"a": 1}) + b"x"])
def test_garbage_gets_an_answer(tcp: Endpoints, garbage: bytes) -> None:
    with serving(tcp), closing(plain_socket(zmq.REQ, tcp.command)) as client:
        client.send(garbage)
        assert msgpack.unpackb(client.recv())["error"]["code"] == "bad_message"


def test_bytes_that_are_not_even_zeromq_disturb_nobody(tcp: Endpoints) -> None:
    host, port = tcp.command.removeprefix("tcp://").split(":")
    with serving(tcp), CommandClient(tcp) as client:
        for noise in (b"GET / HTTP/1.1\r\n\r\n" * 10, b"\xff" * 500, b"\x00" * 64):
            with socket.create_connection((host, int(port)), timeout=5) as stranger:
                stranger.sendall(noise)
        assert client.request({"command": "status"})["ok"] is True


def test_an_oversized_request_is_dropped_with_its_connection(tcp: Endpoints) -> None:
    with serving(tcp), CommandClient(tcp) as client, closing(plain_socket(zmq.DEALER, tcp.command)) as rude:
        rude.send(b"x" * (MAX_REQUEST_BYTES + 1))
        assert client.request({"command": "status"})["ok"] is True
        assert not rude.poll(100)


def test_the_client_over_ipc(endpoints: Endpoints) -> None:
    assert endpoints.command.startswith("ipc://")
    with serving(endpoints), CommandClient(endpoints) as client:
        assert client.request({"command": "x", "n": 1})["you_said"] == {"command": "x", "n": 1}


def test_no_answer_is_told_and_a_late_one_is_not_taken_for_another(endpoints: Endpoints) -> None:
    with closing(CommandServer(endpoints, None)) as server, CommandClient(endpoints, timeout_s=10) as client:
        with pytest.raises(NoAnswerError, match="is the stack running"):
            client.request({"command": "first"}, timeout_s=0.1)
        assert Poller(server).wait(5)
        [(late, _)] = server.receive()
        answered = threading.Thread(target=_answer_late_and_next, args=(server, late))
        answered.start()
        assert client.request({"command": "second"}) == {"to": "second"}
        answered.join(5)


def _answer_late_and_next(server: CommandServer, late: object) -> None:
    assert Poller(server).wait(5)
    [(back, _)] = server.receive()
    server.answer(late, {"to": "first"})  # type: ignore[arg-type]
    server.answer(back, {"to": "second"})


def test_nobody_there(endpoints: Endpoints) -> None:
    with CommandClient(endpoints) as client, pytest.raises(NoAnswerError) as caught:
        client.request({"command": "status"}, timeout_s=0.05)
    assert caught.value.exit_code == 4


def test_a_wrong_address_is_a_configuration_error() -> None:
    with pytest.raises(ConfigError, match="no address"):
        CommandClient("localhost:5750")


@pytest.mark.parametrize("address", ["tcp://0.0.0.0:5750", "tcp://*:5750"])
def test_reachable_from_outside_needs_keys(endpoints: Endpoints, address: str) -> None:
    with pytest.raises(ConfigError, match="CURVE keys"):
        CommandServer(replace(endpoints, command=address), None)
    assert list(endpoints.run_dir.iterdir()) == []


def test_an_address_in_use_is_a_taken_name(tcp: Endpoints) -> None:
    host, port = tcp.command.removeprefix("tcp://").split(":")
    with closing(socket.socket()) as other:
        other.bind((host, int(port)))
        other.listen()
        with pytest.raises(NameTakenError, match="in use"):
            CommandServer(tcp, None)
    with serving(tcp), pytest.raises(NameTakenError, match=r"control \(pid"):
        CommandServer(tcp, None)


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:99999", "tcp://127.0.0.1:x", "udp://127.0.0.1:1", "tcp://198.51.100.7:5750"]
)
def test_an_address_that_cannot_be_bound(endpoints: Endpoints, keys: Path, address: str) -> None:
    with pytest.raises(ConfigError):
        CommandServer(replace(endpoints, command=address), keys)
    assert list(endpoints.run_dir.iterdir()) == []


# --- keys -------------------------------------------------------------------------------------------------


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    create_keys(tmp_path / "keys")
    return tmp_path / "keys"


def test_keys_are_private(keys: Path) -> None:
    assert stat.S_IMODE(keys.stat().st_mode) == 0o700
    for name in ("server.key_secret", "client.key_secret"):
        assert stat.S_IMODE((keys / name).stat().st_mode) == 0o600
    assert [path.name for path in (keys / "authorized").iterdir()] == ["client.key"]
    assert b"secret" not in (keys / "authorized" / "client.key").read_bytes().lower().replace(b"secret key", b"")


def test_keys_are_never_replaced(keys: Path) -> None:
    before = (keys / "server.key_secret").read_bytes()
    with pytest.raises(RefusedError, match="has keys already"):
        create_keys(keys)
    with pytest.raises(RefusedError, match="has a client"):
        add_client(keys, "client")
    assert (keys / "server.key_secret").read_bytes() == before


@pytest.mark.parametrize("name", ["server", "../x", "a/b", ""])
def test_a_clients_name_is_a_name(keys: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="can't be a client's name"):
        add_client(keys, name)


def test_who_has_a_key_is_served_even_on_all_interfaces(tcp: Endpoints, keys: Path) -> None:
    port = tcp.command.rpartition(":")[2]
    open_to_all = replace(tcp, command=f"tcp://0.0.0.0:{port}")
    with serving(open_to_all, keys), CommandClient(tcp, keys_dir=keys) as client:
        assert client.request({"command": "status"})["ok"] is True


def test_who_has_none_or_an_unknown_one_is_not(tcp: Endpoints, keys: Path, tmp_path: Path) -> None:
    with serving(tcp, keys):
        with CommandClient(tcp) as plain, pytest.raises(NoAnswerError):
            plain.request({"command": "status"}, timeout_s=0.3)
        strange = tmp_path / "strange"
        create_keys(strange)
        (strange / "server.key").write_bytes((keys / "server.key").read_bytes())
        with CommandClient(tcp, keys_dir=strange) as unknown, pytest.raises(NoAnswerError):
            unknown.request({"command": "status"}, timeout_s=0.3)


def test_a_client_is_added_and_removed_without_a_restart(tcp: Endpoints, keys: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    create_keys(other)
    (other / "server.key").write_bytes((keys / "server.key").read_bytes())
    with serving(tcp, keys):
        entry = keys / "authorized" / "other.key"
        entry.write_bytes((other / "client.key").read_bytes())
        with CommandClient(tcp, keys_dir=other) as client:
            assert client.request({"command": "status"})["ok"] is True
        entry.unlink()
        with CommandClient(tcp, keys_dir=other) as client, pytest.raises(NoAnswerError):
            client.request({"command": "status"}, timeout_s=0.3)


def test_nobody_gets_in_when_the_keys_become_unreadable(tcp: Endpoints, keys: Path) -> None:
    with serving(tcp, keys):
        (keys / "authorized" / "broken.key").write_text("no key at all")
        with CommandClient(tcp, keys_dir=keys) as client, pytest.raises(NoAnswerError):
            client.request({"command": "status"}, timeout_s=0.3)


def test_a_key_folder_that_cannot_be_read_for_a_while_ends_nothing(tcp: Endpoints, keys: Path) -> None:
    allowed, away = keys / "authorized", keys / "away"
    with serving(tcp, keys):
        allowed.rename(away)
        allowed.symlink_to("x" * 300)  # an OSError for root too, whom no mode keeps out
        with CommandClient(tcp, keys_dir=keys) as client, pytest.raises(NoAnswerError):
            client.request({"command": "status"}, timeout_s=0.3)
        allowed.unlink()
        away.rename(allowed)
        with CommandClient(tcp, keys_dir=keys) as client:
            assert client.request({"command": "status"})["ok"] is True


def test_missing_or_open_keys_are_a_configuration_error(tcp: Endpoints, keys: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="tagmill keys"):
        CommandServer(tcp, tmp_path / "nowhere")
    (keys / "server.key_secret").chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600"):
        CommandServer(tcp, keys)
    (keys / "server.key_secret").chmod(0o600)
    (keys / "authorized" / "client.key").unlink()
    (keys / "authorized").rmdir()
    with pytest.raises(ConfigError, match="nobody could reach"):
        CommandServer(tcp, keys)
