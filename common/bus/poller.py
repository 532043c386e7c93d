"""Waiting for several sockets with a deadline."""

from __future__ import annotations

import math
import select
from typing import Protocol

import zmq

from common.bus.sockets import READABLE, Socket


class SocketOwner(Protocol):
    """Anything that receives on several sockets."""

    @property
    def sockets(self) -> tuple[Socket | int, ...]:
        """The sockets (or file descriptors) to wait on; may change during its life."""


class FileLike(Protocol):
    """A pipe or the like that becomes readable (a worker's connection)."""

    def fileno(self) -> int:
        """Its descriptor."""


Waitable = SocketOwner | FileLike | int


class Poller:
    """Waits until any of its members can be read. Always POLLIN: zmq's default would spin a core."""

    def __init__(self, *members: Waitable) -> None:
        self._members: list[Waitable] = list(members)
        self._made: list[tuple[Socket | int, int]] = []
        self._made_of: list[Socket | int] = []

    def add(self, member: Waitable) -> None:
        """Wait for this one too: an owner of sockets, something with ``fileno`` or a file descriptor."""
        if not any(member is known for known in self._members):
            self._members.append(member)

    def remove(self, member: Waitable) -> None:
        """No longer wait for it; unknown ones are ignored."""
        self._members = [known for known in self._members if known is not member]

    def wait(self, timeout_s: float) -> bool:
        """Wait at most ``timeout_s``; True as soon as something can be received."""
        parts: list[Socket | int] = []
        for member in self._members:
            parts += _parts(member)
        if not parts:
            select.select((), (), (), max(0.0, timeout_s))  # zmq would return at once, and its caller spin
            return False
        if parts != self._made_of:
            self._made = [(part, READABLE) for part in parts]
            self._made_of = parts
        # What zmq.Poller calls; its caller finds it in the cache when it asks what there is to read.
        return bool(zmq.zmq_poll(self._made, max(0, math.ceil(timeout_s * 1000))))


def _parts(member: Waitable) -> tuple[Socket | int, ...]:
    if isinstance(member, int):
        return (member,)
    sockets: tuple[Socket | int, ...] | None = getattr(member, "sockets", None)
    if sockets is not None:
        return sockets
    return (member.fileno(),)  # type: ignore[union-attr]
