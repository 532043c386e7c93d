"""Taking orders: a repeated order is handed over again, since its owner answers it from its table or disk."""

from __future__ import annotations

from dataclasses import dataclass
from types import UnionType
from typing import Any, get_args

import zmq

from common import clock, log
from common.bus.sockets import GOODBYE, ROOM_FOR_FRAMING, Binding, Socket, drain, new_socket, reply
from common.errors import CodecError
from common.messages import MAX_BYTES, Answer, ErrorInfo, Order, encode, unpack, validate

_LOG = log.get()
_MAX_DRAIN = 256
_QUEUE = 1000
_RECENT_NS = 1_000_000_000
_GOODBYE_NS = 1_000_000_000
"""A server that goes waits so long for who was answered so recently."""


@dataclass(frozen=True, slots=True)
class Return:
    """Where an answer goes: the client's identity, and the envelope it wants back."""

    identity: bytes
    envelope: tuple[bytes, ...] = ()


class OrderServer:
    """Receives orders of the given ``kinds`` (classes, or one union such as ``StoreSideOrder``). One a thread.

    ``bad`` counts garbage (answered with ``bad_order`` where its key can be read), ``unreachable`` answers whose
    client was away: it asks again when it is back. Raises NameTakenError if another process serves ``endpoint``.
    """

    def __init__(
        self, endpoint: str, kinds: tuple[type[Order], ...] | UnionType | type[Order], holder: str = "a service"
    ) -> None:
        self.bad = 0
        self.unreachable = 0
        self._kinds = _by_kind(kinds)
        self._answered_ns: dict[bytes, int] = {}
        self._socket = new_socket(
            zmq.ROUTER,
            {
                zmq.ROUTER_MANDATORY: 1,
                zmq.ROUTER_HANDOVER: 1,  # a restarted client takes its identity over
                zmq.SNDHWM: _QUEUE,
                zmq.RCVHWM: _QUEUE,
                zmq.MAXMSGSIZE: MAX_BYTES + ROOM_FOR_FRAMING,
            },
        )
        try:
            self._binding = Binding(self._socket, endpoint, holder)
        except BaseException:
            self._socket.close(linger=0)
            raise

    @property
    def sockets(self) -> tuple[Socket, ...]:
        """For the Poller."""
        return () if self._socket.closed else (self._socket,)

    def receive(self) -> list[tuple[Return, Order]]:
        """The orders that are there, without waiting; garbage is counted and, if possible, answered."""
        orders: list[tuple[Return, Order]] = []
        for identity, *parts in drain(self._socket, _MAX_DRAIN):
            if parts[-1:] == [GOODBYE]:  # meant for the server before this one
                continue
            return_ = Return(identity)
            plain: Any = None
            try:
                plain = unpack(parts[-1] if parts else b"")
                orders.append((return_, self._order(plain)))
            except CodecError as error:
                self._garbage(return_, plain, error)
        return orders

    def answer(self, return_: Return, answer: Answer) -> None:
        """Send the final answer; never blocks, an unreachable client is counted."""
        if reply(self._socket, (return_.identity, encode(answer))):
            self._answered_ns[return_.identity] = clock.monotonic_ns()
        else:
            self.unreachable += 1

    def close(self) -> None:
        """Remove the socket file and close, once the last answers are read or a second has passed; idempotent."""
        if not self._socket.closed:
            self._part()
        self._binding.release()

    def _part(self) -> None:
        """Wait for who was answered a moment ago: a client's socket drops what it hasn't read when its server goes.

        (ZMQ_IMMEDIATE has it do so; without, orders that nobody sees would wait in it for the next server.)
        """
        now = clock.monotonic_ns()
        recent = [identity for identity, at_ns in self._answered_ns.items() if now - at_ns < _RECENT_NS]
        waiting = {identity for identity in recent if reply(self._socket, (identity, GOODBYE))}
        deadline = now + _GOODBYE_NS
        while waiting and (left_ms := (deadline - clock.monotonic_ns()) // 1_000_000) > 0:
            self._socket.poll(left_ms, zmq.POLLIN)
            for identity, *parts in drain(self._socket, _MAX_DRAIN):
                if parts[-1:] == [GOODBYE]:  # an order that comes now is given again to the next server
                    waiting.discard(identity)

    def _order(self, plain: Any) -> Order:
        kind = plain.get("kind") if isinstance(plain, dict) else None
        model = self._kinds.get(kind) if isinstance(kind, str) else None
        if model is None:
            raise CodecError(f"an order needs a kind of {', '.join(sorted(self._kinds))}, not {str(kind)[:40]!r}")
        return validate(model, plain)

    def _garbage(self, return_: Return, plain: Any, error: CodecError) -> None:
        self.bad += 1
        if self.bad == 1:
            _LOG.warning("orders.garbage", what=error.message)
        key = plain.get("key") if isinstance(plain, dict) else None
        if isinstance(key, str):
            self.answer(return_, Answer(key=key, error=ErrorInfo(code="bad_order", message=error.message)))


def _by_kind(kinds: tuple[type[Order], ...] | UnionType | type[Order]) -> dict[str, type[Order]]:
    if isinstance(kinds, UnionType):
        kinds = get_args(kinds)
    elif isinstance(kinds, type):
        kinds = (kinds,)
    return {kind.model_fields["kind"].default: kind for kind in kinds}
