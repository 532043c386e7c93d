"""The rival: pixels as ZeroMQ messages, PUB to SUB without a proxy, without a copy where ZeroMQ can do without.

The only module outside of ``common.bus`` that speaks ZeroMQ, since it is what that is measured against.
"""

from __future__ import annotations

import numpy as np
import zmq

from common.messages import FrameAnnounced, decode, encode
from tools.bench.bus.frames import HEIGHT, WIDTH, Frame, Taken, Work, announced, stamp

_QUEUE = 12
"""As many frames as our ring has slots."""


class ZmqSender:
    """Publishes header, picture and depth as three parts of one message."""

    def __init__(self, address: str) -> None:
        self._number = 0
        self._socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.PUB)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.SNDHWM, _QUEUE)
        self._socket.bind(address)

    def send(self, frame: Frame, count: int, captured_ns: int) -> None:
        """See Sender."""
        self._number += 1
        header = encode(announced("", self._number, count, captured_ns).stamped(stamp(self._number)))
        self._socket.send_multipart((header, frame.bgr.data, frame.depth.data), copy=False)

    def close(self) -> None:
        """See Sender."""
        self._socket.close()


class ZmqReceiver:
    """Receives the message and works on its own memory, so that a full copy costs it nothing more."""

    def __init__(self, address: str) -> None:
        self.lost = 0
        self._work = Work("grey")
        self._socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.SUB)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.RCVHWM, _QUEUE)
        self._socket.setsockopt(zmq.SUBSCRIBE, b"")
        self._socket.connect(address)

    def receive(self, timeout_s: float) -> list[Taken]:
        """See Receiver."""
        if not self._socket.poll(int(timeout_s * 1000), zmq.POLLIN):
            return []
        header, colour, depth = self._socket.recv_multipart(copy=False)
        ref = decode(FrameAnnounced, header.bytes).ref
        bgr = np.frombuffer(colour.buffer, np.uint8).reshape(HEIGHT, WIDTH, 3)
        self._work.do(bgr, np.frombuffer(depth.buffer, np.uint16).reshape(HEIGHT, WIDTH))
        return [Taken(ref.count, ref.captured_mono_ns)]

    def close(self) -> None:
        """See Receiver."""
        self._socket.close()
