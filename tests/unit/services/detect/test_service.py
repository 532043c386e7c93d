"""The detect service on a real bus and real rings."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from common import log
from common.bus import Endpoints, Poller, Proxy, Publisher, Subscriber
from common.config import load_rig
from common.config.models import NetworkConfig
from common.frames import FrameWriter, segment_name
from common.labels import CameraLabel
from common.messages import CameraState, DetectedMarker, Detections, FrameAnnounced, FrameRef, Shares
from common.service import Context
from common.topics import CAMERA, DETECTIONS, FRAME, SHARES
from services.detect.markers import MarkerDetector
from services.detect.service import DetectService
from tests.support.hygiene import Place
from tests.support.stack import RIG, Stack, write_rig

DEADLINE_S = 20.0
SIZE = (160, 120)
MATRIX = ((200.0, 0.0, 79.5), (0.0, 200.0, 59.5), (0.0, 0.0, 1.0))


def scene(marker: int | None) -> np.ndarray:
    """A picture with an upright AprilTag of this id, its own corners at 40,30 ... 103,93 (pixel edges)."""
    bgr = np.full((SIZE[1], SIZE[0], 3), 200, dtype=np.uint8)
    if marker is not None:
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        drawn = np.rot90(cv2.aruco.generateImageMarker(dictionary, marker, 64), 2)
        bgr[30:94, 40:104] = drawn[:, :, None]
    return bgr


class FakeCamera:
    """The capture side of one camera: a real ring, real announcements; it counts as capture does."""

    def __init__(self, name: str, endpoints: Endpoints, *, paced: bool = False) -> None:
        self.name, self.boot, self.paced = name, f"boot{name}", paced
        self.ring = FrameWriter(segment_name(endpoints.prefix, name, self.boot), *SIZE, False, 6)
        self.publisher = Publisher(endpoints, f"capture.{name}", self.boot)
        self.captured = 0

    def tell(self) -> None:
        label = CameraLabel(name=self.name, width=SIZE[0], height=SIZE[1], matrix=MATRIX, distortion=())
        state = CameraState(
            boot=self.boot,
            phase="streaming",
            driver="files" if self.paced else "test",
            ring=self.ring.name,
            camera=label,
            fps=30.0,
            captured=self.captured,
            paced=self.paced,
        )
        self.publisher.publish(CAMERA, (self.name,), state)

    def write(self, bgr: np.ndarray) -> FrameRef:
        """A frame in the ring, not yet announced."""
        number = self.ring.write(bgr)
        self.captured += 1
        return FrameRef(
            camera=self.name,
            boot=self.boot,
            ring=self.ring.name,
            frame=number,
            count=self.captured,
            captured_mono_ns=time.monotonic_ns(),
            captured_wall_ns=time.time_ns(),
        )

    def announce(self, ref: FrameRef) -> FrameRef:
        self.publisher.publish(FRAME, (self.name,), FrameAnnounced(ref=ref))
        return ref

    def capture(self, bgr: np.ndarray) -> FrameRef:
        return self.announce(self.write(bgr))

    def close(self) -> None:
        self.publisher.close()
        self.ring.close()


class Bench:
    """The bus, fake cameras, a listener, and the service stepped by the test itself."""

    def __init__(self, folder: Path, rig: str = RIG, instance: int = 0) -> None:
        self.endpoints = Endpoints.of(NetworkConfig())
        self.proxy = Proxy(self.endpoints)
        self.proxy.start()
        self.cameras: list[FakeCamera] = []
        self.control = Publisher(self.endpoints, "control", "c0")
        self.subscriber = Subscriber(self.endpoints)
        self.subscriber.subscribe(DETECTIONS)
        self.heard: list[Detections] = []
        context = Context(
            rig=load_rig(write_rig(folder, rig)),
            endpoints=self.endpoints,
            name="detect",
            id=f"detect.{instance}",
            instance=instance,
            camera=None,
            boot="d0",
            log=log.get(),
            args=argparse.Namespace(),
        )
        self.service = DetectService(context)
        self.service.open()

    def camera(self, name: str, *, paced: bool = False) -> FakeCamera:
        self.cameras.append(FakeCamera(name, self.endpoints, paced=paced))
        return self.cameras[-1]

    def step(self) -> None:
        self.service.step(0.02)
        self.heard += [r.message for r in self.subscriber.receive() if isinstance(r.message, Detections)]

    def detections(self, camera: str) -> list[Detections]:
        return [one for one in self.heard if one.ref.camera == camera]

    def connect(self) -> None:
        """Until frames of each camera come back: subscriptions travel with their own delay."""
        deadline = time.monotonic() + DEADLINE_S
        while not all(self.detections(camera.name) for camera in self.cameras):
            assert time.monotonic() < deadline, "no detections came back"
            for camera in self.cameras:
                camera.tell()
                camera.capture(scene(None))
            self.step()
        self.settle()

    def settle(self) -> None:
        """Until the newest frame of each camera has come back."""
        deadline = time.monotonic() + DEADLINE_S
        while any(self.detections(camera.name)[-1].ref.count < camera.captured for camera in self.cameras):
            assert time.monotonic() < deadline, "the newest frame did not come back"
            self.step()

    def close(self) -> None:
        self.service.close()
        for camera in self.cameras:
            camera.close()
        self.control.close()
        self.subscriber.close()
        self.proxy.close()


@pytest.fixture
def bench(place: Place, tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path)
    try:
        yield made
    finally:
        made.close()


def test_a_frames_markers_are_published_with_its_reference(bench: Bench) -> None:
    camera = bench.camera("cam0")
    bench.connect()
    ref = camera.capture(scene(5))
    bench.settle()
    found = bench.heard[-1]
    assert found.ref == ref
    assert found.source == "markers"
    assert [marker.id for marker in found.markers] == [5]
    expected = np.array([[40, 30], [104, 30], [104, 94], [40, 94]]) - 0.5
    assert np.abs(np.array(found.markers[0].corners) - expected).max() < 0.6
    assert found.took_ns > 0
    assert bench.service.report().cameras == ("cam0",)
    assert bench.service.report().numbers["latency_p50_ms"] > 0


def test_only_the_newest_frame_is_looked_at_and_the_rest_is_counted(bench: Bench) -> None:
    camera = bench.camera("cam0")
    bench.connect()
    before = bench.heard[-1]
    refs = [camera.capture(scene(n)) for n in range(4)]
    bench.settle()
    news = [one for one in bench.heard if one.ref.count > before.ref.count]
    assert news[-1].ref == refs[-1]
    skipped = news[-1].skipped.get("superseded", 0) - before.skipped.get("superseded", 0)
    assert len(news) + skipped == 4
    assert bench.service.report().dropped.get("superseded", 0) == news[-1].skipped.get("superseded", 0)


def test_cameras_are_served_in_turn(bench: Bench) -> None:
    for name in ("cam0", "cam1", "cam2"):
        bench.camera(name)
    bench.connect()
    bench.heard.clear()
    deadline = time.monotonic() + DEADLINE_S
    # Every camera always has a frame waiting, so a service that favoured one would starve the others.
    while len(bench.heard) < 15:
        assert time.monotonic() < deadline
        for camera in bench.cameras:
            camera.capture(scene(1))
        bench.step()
    counts = [len(bench.detections(camera.name)) for camera in bench.cameras]
    assert max(counts) - min(counts) <= 2, counts


def test_a_lost_and_a_stale_frame_are_counted(bench: Bench) -> None:
    camera = bench.camera("cam0")
    bench.connect()
    gone = camera.write(scene(1)).model_copy(update={"frame": 10_000})
    camera.announce(gone)
    deadline = time.monotonic() + DEADLINE_S
    while bench.service.report().dropped.get("frame_lost", 0) < 1:
        assert time.monotonic() < deadline
        bench.step()
    camera.ring.close()
    camera.boot = "later"
    camera.ring = FrameWriter(segment_name(bench.endpoints.prefix, "cam0", "later"), *SIZE, False, 6)
    camera.captured = 0
    camera.tell()
    old = camera.write(scene(1))
    camera.announce(old.model_copy(update={"captured_mono_ns": old.captured_mono_ns - 10_000_000_000}))
    while bench.service.report().dropped.get("stale", 0) < 1:
        assert time.monotonic() < deadline
        bench.step()
    fresh = camera.capture(scene(7))
    while bench.heard[-1].ref != fresh:
        assert time.monotonic() < deadline
        bench.step()
    assert [marker.id for marker in bench.heard[-1].markers] == [7]
    assert (bench.heard[-1].skipped["frame_lost"], bench.heard[-1].skipped["stale"]) == (1, 1)


class Counting:
    """A detector that counts its calls."""

    def __init__(self, detector: MarkerDetector) -> None:
        self.detector = detector
        self.family = detector.family
        self.calls = 0

    def detect(self, grey: np.ndarray) -> list[DetectedMarker]:
        self.calls += 1
        return self.detector.detect(grey)


def test_a_paced_camera_is_searched_thoroughly(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.camera("cam0", paced=True)
    bench.camera("cam1")
    fast, thorough = Counting(bench.service._fast), Counting(bench.service._thorough)
    monkeypatch.setattr(bench.service, "_fast", fast)
    monkeypatch.setattr(bench.service, "_thorough", thorough)
    bench.connect()
    assert (thorough.calls, fast.calls) == (len(bench.detections("cam0")), len(bench.detections("cam1")))


def test_cameras_are_shared_out_by_the_table(place: Place, tmp_path: Path) -> None:
    made = Bench(tmp_path, RIG + "workers: {detect: 2}\n", instance=1)
    try:
        mine, other = made.camera("cam0"), made.camera("cam1")
        deadline = time.monotonic() + DEADLINE_S
        while not made.detections("cam0"):
            assert time.monotonic() < deadline
            made.control.publish(SHARES, (), Shares(detect={"cam0": 1, "cam1": 0}, label={}))
            for camera in (other, mine):
                camera.tell()
                camera.capture(scene(None))
            made.step()
        assert made.detections("cam1") == []
        assert made.service.report().cameras == ("cam0",)
        while not made.detections("cam1"):
            assert time.monotonic() < deadline
            made.control.publish(SHARES, (), Shares(detect={"cam0": 1, "cam1": 1}, label={}))
            other.tell()
            other.capture(scene(None))
            made.step()
        # What instance 0 has looked at meanwhile is not this one's to count.
        assert made.detections("cam1")[0].skipped == {}
    finally:
        made.close()


@pytest.mark.process
def test_the_real_process_serves_and_ends_when_asked(stack: Stack, place: Place, tmp_path: Path) -> None:
    rig = write_rig(tmp_path)
    stack.start_module("tests.support.bus_only", "--rig", str(rig)).wait_for_event("service.opened")
    detect = stack.start_service("detect", rig)
    detect.wait_for_event("service.opened")
    listener = stack.listen(DETECTIONS)
    camera = FakeCamera("cam0", stack.endpoints)
    try:
        deadline = time.monotonic() + DEADLINE_S
        poller = Poller(listener.subscriber)
        found: list[Detections] = []
        while not found:
            assert time.monotonic() < deadline, detect.log()
            camera.tell()
            camera.capture(scene(9))
            poller.wait(0.1)
            found = [r.message for r in listener.subscriber.receive() if isinstance(r.message, Detections)]
        assert [marker.id for marker in found[-1].markers] == [9]
        assert detect.stop() == 0
    finally:
        camera.close()
