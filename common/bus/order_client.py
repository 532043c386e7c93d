"""Giving orders: what must not be lost, and gets exactly one final answer."""

from __future__ import annotations

import zmq

from common import clock, log
from common.bus.order_table import OrderTable
from common.bus.sockets import GOODBYE, ROOM_FOR_FRAMING, Socket, drain, new_socket
from common.errors import CodecError
from common.messages import MAX_BYTES, Answer, Order, decode, encode

_LOG = log.get()
_MAX_DRAIN = 1000


class OrderClient:
    """Sends orders to one server and keeps every unanswered one (at most ``window``). One a thread.

    ``identity`` must be the same in each life of this client (its service id), so that an answer finds it.
    ``repeated`` counts answers nobody waits for (any more), ``resent`` orders sent again, ``bad`` garbage.
    """

    def __init__(self, endpoint: str, identity: str, window: int = 64) -> None:
        self.bad = 0
        self.repeated = 0
        self.resent = 0
        self._table = OrderTable(window)
        options = {
            zmq.ROUTING_ID: identity.encode(),
            zmq.IMMEDIATE: 1,  # without a connection: EAGAIN, instead of a queue nobody sees
            zmq.SNDHWM: 2 * window,
            zmq.RCVHWM: 4 * window,
            zmq.MAXMSGSIZE: MAX_BYTES + ROOM_FOR_FRAMING,
        }
        self._socket: Socket | None = new_socket(zmq.DEALER, options)
        self._socket.connect(endpoint)

    @property
    def sockets(self) -> tuple[Socket, ...]:
        """For the Poller."""
        return () if self._socket is None else (self._socket,)

    @property
    def available(self) -> bool:
        """Whether an order given now would go at once: there is a connection, and a sign of life within 3 s."""
        if self._socket is None or not self._table.peer_is_fresh(clock.monotonic_ns()):
            return False
        return bool(self._socket.poll(0, zmq.POLLOUT))

    @property
    def pending(self) -> tuple[str, ...]:
        """Keys of the unanswered orders, oldest first."""
        return tuple(self._table.entries)

    def send(self, order: Order) -> None:
        """Enter the order and send it, now or at the next event; a key already in the table changes nothing.

        Raises RefusedError ``backlog_full`` if ``window`` orders are unanswered, CodecError if it is too large.
        """
        if self._table.add(order.key, encode(order)):
            self._table.flush(self._transmit, clock.monotonic_ns())

    def peer_seen(self, boot: str) -> None:
        """To be called on each ServiceState of the peer: sends what waits, resends what a restart took."""
        self.resent += self._table.peer_seen(boot, self._transmit, clock.monotonic_ns())

    def receive(self) -> list[Answer]:
        """The answers that are there, each once, without waiting."""
        self._table.flush(self._transmit, clock.monotonic_ns())
        answers: list[Answer] = []
        if self._socket is None:
            raise ValueError("the order client is closed")
        for parts in drain(self._socket, _MAX_DRAIN):
            if parts[-1] == GOODBYE:  # the server goes when it knows that its last answers were read
                self._transmit(GOODBYE)
                continue
            try:
                answer = decode(Answer, parts[-1])
            except CodecError as error:
                self.bad += 1
                if self.bad == 1:
                    _LOG.warning("orders.garbage", what=error.message)
                continue
            if self._table.answered(answer.key):
                answers.append(answer)
            else:
                self.repeated += 1
        return answers

    def forget(self, key: str) -> None:
        """No longer wait for this order's answer, nor resend it."""
        self._table.answered(key)

    def close(self) -> None:
        """Close at once; unanswered orders are forgotten. Idempotent."""
        if self._socket is not None:
            self._socket.close(linger=0)
            self._socket = None

    def _transmit(self, data: bytes) -> bool:
        if self._socket is None:
            raise ValueError("the order client is closed")
        try:
            self._socket.send(data, zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True
