"""The other rival: iceoryx2, pixels in its shared memory, an event of its own to wake the readers."""

from __future__ import annotations

import ctypes

import iceoryx2 as iox2
import numpy as np

from common.messages import FrameAnnounced, decode, encode
from tools.bench.bus.frames import (
    COLOUR_BYTES,
    DEPTH_BYTES,
    HEIGHT,
    WIDTH,
    Form,
    Frame,
    Taken,
    Work,
    announced,
    stamp,
)

_QUEUE = 12
_MOST_READERS = 16
_HEADER_BYTES = 4096
_BYTES = _HEADER_BYTES + COLOUR_BYTES + DEPTH_BYTES
_LENGTH_BYTES = 4


class _Node:
    """A node with the service of frames and the event that tells of them."""

    def __init__(self, name: str) -> None:
        iox2.set_log_level(iox2.LogLevel.Error)
        self.node = iox2.NodeBuilder.new().create(iox2.ServiceType.Ipc)
        self.frames = (
            self.node.service_builder(iox2.ServiceName.new(f"{name}/frames"))
            .publish_subscribe(iox2.Slice[ctypes.c_uint8])
            .max_publishers(1)
            .max_subscribers(_MOST_READERS)
            .subscriber_max_buffer_size(_QUEUE)
            .enable_safe_overflow(True)
            .open_or_create()
        )
        self.event = (
            self.node.service_builder(iox2.ServiceName.new(f"{name}/event"))
            .event()
            .max_listeners(_MOST_READERS)
            .open_or_create()
        )


class IceoryxSender:
    """Loans a sample, fills it, sends it, tells of it."""

    def __init__(self, name: str) -> None:
        self._number = 0
        self._node = _Node(name)
        self._publisher = self._node.frames.publisher_builder().initial_max_slice_len(_BYTES).create()
        self._notifier = self._node.event.notifier_builder().create()

    def send(self, frame: Frame, count: int, captured_ns: int) -> None:
        """See Sender."""
        self._number += 1
        header = encode(announced("", self._number, count, captured_ns).stamped(stamp(self._number)))
        loan = self._publisher.loan_slice_uninit(_BYTES)
        slot = np.frombuffer(loan.payload().as_memory_view(), np.uint8)
        slot[:_LENGTH_BYTES].view(np.uint32)[0] = len(header)
        slot[_LENGTH_BYTES : _LENGTH_BYTES + len(header)] = np.frombuffer(header, np.uint8)
        np.copyto(slot[_HEADER_BYTES : _HEADER_BYTES + COLOUR_BYTES], frame.bgr.reshape(-1))
        np.copyto(slot[_HEADER_BYTES + COLOUR_BYTES :].view(np.uint16), frame.depth.reshape(-1))
        del slot
        loan.assume_init().send()
        self._notifier.notify()

    def close(self) -> None:
        """See Sender."""
        del self._publisher, self._notifier, self._node


class IceoryxReceiver:
    """Waits for the event, takes what there is, works in place."""

    def __init__(self, name: str, form: Form) -> None:
        self.lost = 0
        self._work = Work(form)
        self._node = _Node(name)
        self._subscriber = self._node.frames.subscriber_builder().buffer_size(_QUEUE).create()
        self._listener = self._node.event.listener_builder().create()

    def receive(self, timeout_s: float) -> list[Taken]:
        """See Receiver."""
        self._listener.timed_wait(iox2.Duration.from_secs_f64(timeout_s))
        taken = []
        while (sample := self._subscriber.receive()) is not None:
            slot = np.frombuffer(sample.payload().as_memory_view(), np.uint8)
            length = int(slot[:_LENGTH_BYTES].view(np.uint32)[0])
            ref = decode(FrameAnnounced, slot[_LENGTH_BYTES : _LENGTH_BYTES + length].tobytes()).ref
            bgr = slot[_HEADER_BYTES : _HEADER_BYTES + COLOUR_BYTES].reshape(HEIGHT, WIDTH, 3)
            depth = slot[_HEADER_BYTES + COLOUR_BYTES :].view(np.uint16).reshape(HEIGHT, WIDTH)
            self._work.do(bgr, depth)
            del bgr, depth, slot
            sample.delete()
            taken.append(Taken(ref.count, ref.captured_mono_ns))
        return taken

    def close(self) -> None:
        """See Receiver."""
        del self._subscriber, self._listener, self._node
