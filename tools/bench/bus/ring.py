"""Our way: the frame into the ring, the news of it through the proxy."""

from __future__ import annotations

from common.bus import Endpoints, Poller, Publisher, Subscriber
from common.config.models import NetworkConfig
from common.errors import FrameLostError
from common.frames import FrameReader, FrameWriter, segment_name
from common.messages import FrameAnnounced
from common.topics import FRAME
from tools.bench.bus.frames import BOOT, CAMERA, HEIGHT, WIDTH, Form, Frame, Taken, Work, announced

_SLOTS = 12


class RingSender:
    """Writes the ring, announces."""

    def __init__(self) -> None:
        endpoints = Endpoints.of(NetworkConfig())
        name = segment_name(endpoints.prefix, CAMERA, BOOT)
        self._ring = FrameWriter(name, WIDTH, HEIGHT, True, _SLOTS)
        self._publisher = Publisher(endpoints, "capture.cam0", BOOT)

    def send(self, frame: Frame, count: int, captured_ns: int) -> None:
        """See Sender."""
        number = self._ring.write(frame.bgr, frame.depth)
        self._publisher.publish(FRAME, (CAMERA,), announced(self._ring.name, number, count, captured_ns))

    def close(self) -> None:
        """See Sender."""
        self._publisher.close()
        self._ring.close()


class RingReceiver:
    """Hears of frames, reads them in the ring under the sequence check."""

    def __init__(self, form: Form) -> None:
        self.lost = 0
        self._work = Work(form)
        self._subscriber = Subscriber(Endpoints.of(NetworkConfig()))
        self._subscriber.subscribe(FRAME, CAMERA)
        self._poller = Poller(self._subscriber)
        self._ring: FrameReader | None = None

    def receive(self, timeout_s: float) -> list[Taken]:
        """See Receiver."""
        self._poller.wait(timeout_s)
        taken = []
        for received in self._subscriber.receive():
            assert isinstance(received.message, FrameAnnounced)
            ref = received.message.ref
            try:
                if self._ring is None:
                    self._ring = FrameReader(ref.ring)
                with self._ring.view(ref.frame) as view:
                    assert view.depth is not None
                    self._work.do(view.bgr, view.depth)
            except FrameLostError:
                self.lost += 1
                continue
            taken.append(Taken(ref.count, ref.captured_mono_ns))
        return taken

    def close(self) -> None:
        """See Receiver."""
        self._subscriber.close()
        if self._ring is not None:
            self._ring.close()
