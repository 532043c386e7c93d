"""The bus itself: publishers meet subscribers, and a slow one of these costs only itself."""

from __future__ import annotations

import threading

import zmq

from common.bus.endpoints import Endpoints
from common.bus.sockets import BUS_QUEUE, PREVIEW_QUEUE, ROOM_FOR_FRAMING, Binding, Socket, new_socket
from common.messages import MAX_BYTES

_JOIN_S = 5.0


class Proxy:
    """XSUB/XPUB pairs, one for the bus and one for previews, each forwarded by a thread in C.

    A message beyond the codec's size limit costs its sender the connection and reaches nobody.
    """

    def __init__(self, endpoints: Endpoints, holder: str = "the bus proxy") -> None:
        self._endpoints = endpoints
        self._holder = holder
        self._context: zmq.Context[Socket] | None = None
        self._bindings: list[Binding] = []
        self._threads: list[threading.Thread] = []

    def start(self) -> None:
        """Bind and forward; raises NameTakenError if another proxy serves this stack."""
        self._endpoints.prepare()
        self._context = zmq.Context()
        lanes = (
            ("bus", self._endpoints.publish, self._endpoints.subscribe, BUS_QUEUE),
            ("previews", self._endpoints.publish_preview, self._endpoints.subscribe_preview, PREVIEW_QUEUE),
        )
        try:
            pairs = [(name, *self._bind(inside, outside, queue)) for name, inside, outside, queue in lanes]
        except BaseException:
            self.close()
            raise
        for name, inner, outer in pairs:
            thread = threading.Thread(target=_forward, args=(inner, outer), name=f"proxy-{name}", daemon=True)
            thread.start()
            self._threads.append(thread)

    def close(self) -> None:
        """Stop forwarding, remove the socket files; idempotent."""
        if self._context is None:
            return
        for binding in self._bindings:
            binding.unlink()
        if self._threads:
            # Ends zmq.proxy in the threads, which then close their sockets; term itself waits for that.
            self._context.term()
        for thread in self._threads:
            thread.join(_JOIN_S)
        for binding in self._bindings:
            binding.release()
        self._context.term()
        self._context, self._bindings, self._threads = None, [], []

    def _bind(self, inside: str, outside: str, queue: int) -> tuple[Socket, Socket]:
        limit = MAX_BYTES + ROOM_FOR_FRAMING
        inner = new_socket(zmq.XSUB, {zmq.RCVHWM: BUS_QUEUE, zmq.MAXMSGSIZE: limit}, self._context)
        outer = new_socket(zmq.XPUB, {zmq.SNDHWM: queue, zmq.MAXMSGSIZE: ROOM_FOR_FRAMING}, self._context)
        for made, address in ((inner, inside), (outer, outside)):
            try:
                self._bindings.append(Binding(made, address, self._holder))
            except BaseException:
                inner.close(linger=0)
                outer.close(linger=0)
                raise
        return inner, outer


def _forward(inner: Socket, outer: Socket) -> None:
    try:
        zmq.proxy(inner, outer)
    except zmq.ContextTerminated:
        pass  # the order to end
    finally:
        inner.close(linger=0)
        outer.close(linger=0)
