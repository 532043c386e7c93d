"""The command socket's two ends: bytes in, one map out for each request."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import msgpack
import zmq

from common import clock, log
from common.addresses import is_local
from common.bus.endpoints import Endpoints, check_tcp
from common.bus.gatekeeper import Gatekeeper
from common.bus.keys import client_pair, server_pair, server_public
from common.bus.locks import NameLock
from common.bus.order_server import Return
from common.bus.sockets import LAST_ANSWERS_MS, Binding, Socket, drain, new_socket, reply
from common.errors import CodecError, ConfigError, NameTakenError, NoAnswerError
from common.messages import unpack

MAX_REQUEST_BYTES = 64 * 1024
MAX_ANSWER_BYTES = 4 << 20

_LOG = log.get()
_MAX_DRAIN = 100
_QUEUE = 200
_ZAP_DOMAIN = b"tagmill"


class CommandServer:
    """Receives requests as bytes; the caller decodes them and gives exactly one answer (a map) to each.

    REQ and DEALER clients are understood; a request in more than one part is answered with ``bad_request`` here.
    A part beyond 64 KiB costs its sender the connection. ``bad`` counts what couldn't be a request,
    ``unreachable`` answers whose client was gone.

    On anything but loopback, ``keys_dir`` must hold CURVE keys (see ``common.bus.keys``), else ConfigError; with
    keys, a tcp socket is always encrypted. Raises NameTakenError if the address is in use.
    """

    def __init__(self, endpoints: Endpoints, keys_dir: Path | None, holder: str = "control") -> None:
        self.bad = 0
        self.unreachable = 0
        address = endpoints.command
        if not address.startswith("ipc://"):
            check_tcp(address)
        if not is_local(address) and keys_dir is None:
            raise ConfigError(
                f"network.command is {address}, which other machines can reach: that needs CURVE keys; "
                "make them with 'tagmill keys' and name the folder in network.keys, or use 127.0.0.1"
            )
        self._gatekeeper: Gatekeeper | None = None
        self._binding: Binding | None = None
        self._lock: NameLock | None = None
        self._socket = new_socket(
            zmq.ROUTER,
            {
                zmq.ROUTER_MANDATORY: 1,
                zmq.SNDHWM: _QUEUE,
                zmq.RCVHWM: _QUEUE,
                zmq.MAXMSGSIZE: MAX_REQUEST_BYTES,
            },
        )
        try:
            if address.startswith("ipc://"):
                self._binding = Binding(self._socket, address, holder)
            else:
                self._lock = NameLock(endpoints.service_lock("command"), holder)
                if keys_dir is not None:
                    self._require_keys(keys_dir)
                _bind_tcp(self._socket, address)
        except BaseException:
            self.close()
            raise

    @property
    def sockets(self) -> tuple[Socket, ...]:
        """For the Poller."""
        return () if self._socket.closed else (self._socket,)

    def receive(self) -> list[tuple[Return, bytes]]:
        """The requests that are there, without waiting."""
        requests: list[tuple[Return, bytes]] = []
        for identity, *parts in drain(self._socket, _MAX_DRAIN):
            *envelope, body = parts or [b""]
            return_ = Return(identity, tuple(envelope))
            # REQ sends an empty part first, perhaps with a request id before it; a plain DEALER sends none.
            if envelope and envelope[-1] != b"":
                self._garbage(Return(identity), "a request is one MessagePack map in one part")
            else:
                requests.append((return_, body))
        return requests

    def answer(self, return_: Return, answer: dict[str, Any]) -> None:
        """Send the answer; never blocks, a client that is gone is counted."""
        data = msgpack.packb(answer, use_bin_type=True)
        if not reply(self._socket, (return_.identity, *return_.envelope, data)):
            self.unreachable += 1

    def close(self) -> None:
        """Remove what was made, and close: answers that were given still go out for a second. Idempotent."""
        if self._binding is not None:
            self._binding.release()
        if self._gatekeeper is not None:
            self._gatekeeper.close()
        self._socket.close(linger=LAST_ANSWERS_MS)
        if self._lock is not None:
            self._lock.release()

    def _require_keys(self, keys_dir: Path) -> None:
        pair = server_pair(keys_dir)
        self._gatekeeper = Gatekeeper(keys_dir, self._socket)
        self._socket.setsockopt(zmq.ZAP_DOMAIN, _ZAP_DOMAIN)
        # Without this, ZeroMQ lets everybody in while no gatekeeper answers.
        self._socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)
        self._socket.curve_server = True
        self._socket.curve_publickey = pair.public
        self._socket.curve_secretkey = pair.secret

    def _garbage(self, return_: Return, what: str) -> None:
        self.bad += 1
        if self.bad == 1:
            _LOG.warning("commands.garbage", what=what)
        self.answer(return_, {"ok": False, "error": {"code": "bad_request", "message": what}})


class CommandClient:
    """Asks the command socket. One a thread; a late answer to an earlier request is never taken for another's.

    ``run_dir``: the stack's run folder on this machine, None where only an address was given.
    """

    def __init__(self, endpoints: Endpoints | str, timeout_s: float = 5.0, keys_dir: Path | None = None) -> None:
        self._address = endpoints if isinstance(endpoints, str) else endpoints.command
        self.run_dir = None if isinstance(endpoints, str) else endpoints.run_dir
        if not self._address.startswith("ipc://"):
            check_tcp(self._address)
        self._timeout_s = timeout_s
        self._ids = itertools.count(1)
        self._socket = new_socket(zmq.DEALER, {zmq.MAXMSGSIZE: MAX_ANSWER_BYTES})
        try:
            if keys_dir is not None and not self._address.startswith("ipc://"):
                pair = client_pair(keys_dir)
                self._socket.curve_serverkey = server_public(keys_dir)
                self._socket.curve_publickey = pair.public
                self._socket.curve_secretkey = pair.secret
            self._socket.connect(self._address)
        except zmq.ZMQError as error:
            self._socket.close(linger=0)
            raise ConfigError(f"the command socket {self._address} can't be reached: {error.strerror}") from error
        except ConfigError:
            self._socket.close(linger=0)
            raise

    @property
    def address(self) -> str:
        """Where it asks."""
        return self._address

    @property
    def sockets(self) -> tuple[Socket, ...]:
        """For the Poller, where several requests are under way at a time."""
        return () if self._socket.closed else (self._socket,)

    def send(self, request: dict[str, Any]) -> str:
        """Send one request without waiting; returns the number under which ``receive`` gives its answer.

        Raises NoAnswerError if too many wait to be sent.
        """
        number = str(next(self._ids))
        try:
            self._socket.send_multipart((number.encode(), b"", msgpack.packb(request, use_bin_type=True)), zmq.NOBLOCK)
        except zmq.Again as error:
            raise self._no_answer(0.0) from error
        return number

    def receive(self) -> list[tuple[str, dict[str, Any]]]:
        """The answers that are there, by their requests' numbers, without waiting; garbage is answered as such."""
        found: list[tuple[str, dict[str, Any]]] = []
        for parts in drain(self._socket, _MAX_DRAIN):
            if len(parts) == 3:
                try:
                    answer = self._plain(parts[2])
                except CodecError as error:
                    answer = {"ok": False, "error": {"code": error.code, "message": error.message}}
                found.append((parts[0].decode("ascii", "replace"), answer))
        return found

    def request(self, request: dict[str, Any], timeout_s: float | None = None) -> dict[str, Any]:
        """Send one request and wait for its answer.

        Raises NoAnswerError after ``timeout_s`` (default: the client's), CodecError if the answer is garbage.
        """
        limit_s = self._timeout_s if timeout_s is None else timeout_s
        deadline = clock.monotonic_ns() + int(limit_s * 1e9)
        number = self.send(request).encode()
        while (left_ms := (deadline - clock.monotonic_ns()) // 1_000_000) > 0:
            if not self._socket.poll(left_ms, zmq.POLLIN):
                break
            parts = self._socket.recv_multipart(zmq.NOBLOCK)
            if len(parts) == 3 and parts[0] == number:
                return self._plain(parts[2])
        raise self._no_answer(limit_s)

    def close(self) -> None:
        """Close at once; idempotent."""
        self._socket.close(linger=0)

    def __enter__(self) -> CommandClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _plain(self, data: bytes) -> dict[str, Any]:
        answer = unpack(data, MAX_ANSWER_BYTES)
        if not isinstance(answer, dict):
            raise CodecError(f"{self._address} answered with something that is no map")
        return answer

    def _no_answer(self, limit_s: float) -> NoAnswerError:
        return NoAnswerError(
            f"no answer from {self._address} within {limit_s:g} s; is the stack running (tagmill status), "
            "and are address, TAGMILL_PREFIX and keys the same?"
        )


def _bind_tcp(made: Socket, address: str) -> None:
    try:
        made.bind(address)
    except zmq.ZMQError as error:
        if error.errno == zmq.EADDRINUSE:
            raise NameTakenError(
                f"{address} is in use by another program; stop it, or choose another network.command"
            ) from error
        raise ConfigError(
            f"network.command '{address}' can't be bound ({error.strerror}); use e.g. tcp://127.0.0.1:5750"
        ) from error
