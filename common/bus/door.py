"""Who comes to a socket and doesn't even get as far as showing a key that the gatekeeper could look up.

Without CURVE, or with another server's key, a handshake fails inside ZeroMQ. Its monitor tells of it, but not of
whom; so the peer of each new connection is asked for when it is accepted.
"""

from __future__ import annotations

import os
import socket as network
from contextlib import suppress

import zmq
from zmq.utils.monitor import parse_monitor_message

from common.bus.sockets import Socket
from common.refusals import Refusals

UNKNOWN = "unknown (it was gone at once)"
_FAILED = zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_AUTH
_EVENTS = zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED | _FAILED
_MOST_OPEN = 4096


class Door:
    """Watches ``watched``; ``look`` belongs to one thread, the one that polls ``ear``."""

    def __init__(self, watched: Socket, refusals: Refusals) -> None:
        self.ear: Socket = watched.get_monitor_socket(_EVENTS)
        self._watched = watched
        self._refusals = refusals
        self._peers: dict[int, str] = {}
        self._failed: list[str] = []

    def look(self) -> None:
        """Take the news that are there.

        ZeroMQ's one I/O thread tells of a failed handshake, and then that this connection ends: so the two belong
        together.
        """
        with suppress(zmq.Again):
            while True:
                told = parse_monitor_message(self.ear.recv_multipart(zmq.NOBLOCK))
                self._take(told["event"], told["value"])

    def close(self) -> None:
        """Stop watching; the watched socket must still be open."""
        if not self._watched.closed:
            self._watched.disable_monitor()
        self.ear.close(linger=0)

    def _take(self, event: int, value: int) -> None:
        if event == zmq.EVENT_ACCEPTED:
            if len(self._peers) < _MOST_OPEN:
                self._peers[value] = _peer(value)
        elif event == zmq.EVENT_DISCONNECTED:
            address = self._peers.pop(value, UNKNOWN)
            for reason in self._failed:
                self._refusals.note(address, reason)
            self._failed.clear()
        elif event & _FAILED:
            refused_by_gatekeeper = event == zmq.EVENT_HANDSHAKE_FAILED_AUTH
            if not refused_by_gatekeeper:
                self._failed.append("it has no key, or not this server's")


def _peer(descriptor: int) -> str:
    """The other end of a connection that may be gone by now."""
    try:
        with network.socket(fileno=os.dup(descriptor)) as connection:
            return str(connection.getpeername()[0])
    except (OSError, IndexError):
        return UNKNOWN
