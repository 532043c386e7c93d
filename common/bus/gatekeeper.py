"""Who may connect with CURVE: answers ZeroMQ's authentication requests (ZAP, RFC 27) from a folder of keys."""

from __future__ import annotations

import threading
from contextlib import suppress
from pathlib import Path

import zmq
import zmq.utils.z85

from common.bus.door import Door
from common.bus.keys import authorized_keys
from common.bus.sockets import Socket, new_socket
from common.errors import ConfigError
from common.refusals import Refusals

_ZAP = "inproc://zeromq.zap.01"
_STOP = b"stop"
_JOIN_S = 5.0
_PARTS_OF_CURVE_REQUEST = 7


class Gatekeeper:
    """Lets in whose public key lies in ``folder/authorized`` at the moment of connecting to ``guarded``.

    Who is refused is logged, with the address and a limited rate. A thread, since ZeroMQ asks while it shakes hands.
    At most one in a process.
    """

    def __init__(self, folder: Path, guarded: Socket) -> None:
        authorized_keys(folder)
        self._folder = folder
        self._refusals = Refusals("commands.client_refused")
        self._door = new_socket(zmq.REP, {})
        self._bell = new_socket(zmq.PAIR, {})
        ear = new_socket(zmq.PAIR, {})
        try:
            self._door.bind(_ZAP)
            name = f"inproc://gatekeeper-{id(self)}"
            ear.bind(name)
            self._bell.connect(name)
        except zmq.ZMQError:
            for made in (self._door, self._bell, ear):
                made.close(linger=0)
            raise
        self._watch = Door(guarded, self._refusals)
        self._thread = threading.Thread(target=self._serve, args=(ear,), name="gatekeeper", daemon=True)
        self._thread.start()

    @property
    def refused(self) -> int:
        """How many were refused so far."""
        return self._refusals.total

    def close(self) -> None:
        """Stop answering: from here on nobody gets in. Idempotent."""
        if self._bell.closed:
            return
        with suppress(zmq.Again):  # nobody listens any more
            self._bell.send(_STOP, zmq.NOBLOCK)
        self._thread.join(_JOIN_S)
        self._bell.close(linger=0)
        self._watch.close()

    def _serve(self, ear: Socket) -> None:
        poller = zmq.Poller()
        poller.register(ear, zmq.POLLIN)
        poller.register(self._door, zmq.POLLIN)
        poller.register(self._watch.ear, zmq.POLLIN)
        try:
            while ear not in (ready := dict(poller.poll())):
                if self._door in ready:
                    self._door.send_multipart(self._verdict(self._door.recv_multipart()))
                if self._watch.ear in ready:
                    self._watch.look()
        finally:
            self._door.close(linger=0)
            ear.close(linger=0)

    def _verdict(self, request: list[bytes]) -> tuple[bytes, ...]:
        version, request_id, *_ = [*request, b"", b""]
        reason = self._fault(request)
        if reason is None:
            return version, request_id, b"200", b"OK", b"client", b""
        address = request[3].decode("ascii", "replace") if len(request) > 3 else "?"
        self._refusals.note(address, reason)
        return version, request_id, b"400", b"not authorized", b"", b""

    def _fault(self, request: list[bytes]) -> str | None:
        """Why whoever asks isn't let in; None if he is."""
        if len(request) != _PARTS_OF_CURVE_REQUEST or request[5] != b"CURVE":
            return "it has no key"
        try:
            known = zmq.utils.z85.encode(request[6]) in authorized_keys(self._folder)
        except (ConfigError, ValueError) as error:
            return str(error)
        return None if known else "its key is not in authorized/"
