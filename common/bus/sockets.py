"""Making, binding and closing sockets: every option that all of them share is set here."""

from __future__ import annotations

import os
import socket as unix
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import zmq

from common.bus.endpoints import MAX_PATH_BYTES, ipc_path
from common.bus.locks import NameLock
from common.errors import ConfigError

Socket = zmq.Socket[bytes]

BUS_QUEUE = 100
PREVIEW_QUEUE = 4
PUBLISHER_QUEUE = 30
ROOM_FOR_FRAMING = 4096
"""Socket-level limits are this much above the codec's, so that only what is far too large costs the connection."""

_BACKLOG = 128
GOODBYE = b"\xc1goodbye"
"""Between an order server that closes and its clients; no MessagePack begins like this."""
LAST_ANSWERS_MS = 1000
"""What was answered just before the end leaves first: ZeroMQ's own thread may wait for a core longer than that."""
READABLE = int(zmq.POLLIN)
_NOBLOCK = int(zmq.NOBLOCK)
_MORE = int(zmq.NOBLOCK | zmq.SNDMORE)
"""Plain numbers: a live frame's news finds cold caches, where each of zmq's enumerations costs 20 us."""


def new_socket(
    kind: int, options: Mapping[zmq.SocketOption, Any], context: zmq.Context[Socket] | None = None
) -> Socket:
    """A socket of the process's context (or ``context``) with LINGER 0 and the given options."""
    made: Socket = (context or zmq.Context.instance()).socket(kind)
    made.setsockopt(zmq.LINGER, 0)
    for option, value in options.items():
        made.setsockopt(option, value)
    return made


def drain(made: Socket, limit: int) -> Iterator[list[bytes]]:
    """The messages that are there, at most ``limit``, without waiting."""
    wanted = [(made, READABLE)]
    for _ in range(limit):
        # Cheaper than the exception that every drain would end with, and what the Poller has just called.
        if not zmq.zmq_poll(wanted, 0):
            return
        try:
            frame = made.recv(_NOBLOCK, copy=False)
        except zmq.Again:
            return
        parts = [frame.bytes]
        while frame.more:
            frame = made.recv(_NOBLOCK, copy=False)
            parts.append(frame.bytes)
        yield parts


def send_pair(made: Socket, first: bytes, second: bytes) -> None:
    """Send a message of two parts, without waiting; raises zmq.Again where there is no room for it."""
    made.send(first, _MORE)
    made.send(second, _NOBLOCK)


def reply(router: Socket, parts: Sequence[bytes]) -> bool:
    """Send to the client that ``parts[0]`` names, without waiting; False if it is gone or takes nothing."""
    try:
        router.send_multipart(parts, zmq.NOBLOCK)
    except zmq.Again:
        return False
    except zmq.ZMQError as error:
        if error.errno != zmq.EHOSTUNREACH:
            raise
        return False
    return True


def end_context() -> None:
    """Close what the process's context still has open; the last act of a process. Last answers are let out first."""
    zmq.Context.instance().destroy(linger=0)


class Binding:
    """One socket bound to one ipc path, under the path's lock.

    The listener is made here and given to ZeroMQ, because whether ZeroMQ removes a path of its own making depends
    on its version: never, or at some time *after* ``close``, when a successor may have bound it already.
    """

    def __init__(self, bound: Socket, address: str, holder: str) -> None:
        self._socket = bound
        self._path = ipc_path(address)
        if len(os.fsencode(self._path)) > MAX_PATH_BYTES:
            raise ConfigError(
                f"the socket path {self._path} is longer than {MAX_PATH_BYTES} bytes; "
                "set TAGMILL_RUN_DIR to a short path such as /tmp/tm"
            )
        self._lock: NameLock | None = NameLock(self._path.with_name(self._path.name + ".lock"), holder)
        try:
            self._path.unlink(missing_ok=True)
            bound.setsockopt(zmq.USE_FD, _listener(str(self._path)))
            bound.bind(address)
        except (OSError, zmq.ZMQError):
            self.release()
            raise

    def unlink(self) -> None:
        """Remove the socket file: nobody new connects from here on."""
        if self._lock is not None:
            self._path.unlink(missing_ok=True)

    def release(self) -> None:
        """Remove the socket file, close the socket, give the name back; idempotent."""
        if self._lock is None:
            return
        self._path.unlink(missing_ok=True)
        self._socket.close(linger=LAST_ANSWERS_MS)
        self._lock.release()
        self._lock = None


def _listener(path: str) -> int:
    """A listening Unix socket's descriptor; whoever binds it to a ZeroMQ socket hands it over for good."""
    listener = unix.socket(unix.AF_UNIX, unix.SOCK_STREAM | unix.SOCK_NONBLOCK | unix.SOCK_CLOEXEC)
    try:
        listener.bind(path)
        listener.listen(_BACKLOG)
    except OSError:
        listener.close()
        raise
    return listener.detach()
