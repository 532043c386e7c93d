"""The real stack with a detector that overlooks what it is told to: waiting samples, interpolation, `incomplete`."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from common.bus import CommandClient, Endpoints, Poller, Publisher, Subscriber
from common.config.models import NetworkConfig
from common.dataset import SessionReader
from common.messages import DetectedMarker, Detections, FrameAnnounced, FrameRef, Truth
from common.topics import DETECTIONS, FRAME, TRUTH
from services.label.sightings import GAP_NS, SEEN_NS
from tests.support.rigs import box
from tests.support.stack import Stack, wait_for
from tools.cli import main

pytestmark = pytest.mark.process

RIG = (
    """\
dataset: {root: ./dataset, session: complete, keep_original: true}
objects:
"""
    + box()
    + box("box-2", first=10)
    + """\
cameras:
  cam0: {driver: synthetic, width: 640, height: 360, fps: 10, markers: false}
pose: {ambiguous: keep}
ring: {slots: 8, samples: 16}
"""
)


class Overlooking:
    """Plays detect from the renderer's truth; nothing of box-1 in every fourth frame, or in any while ``hidden``.

    ``captured_ns`` of each frame by its number, ``seen_ns`` of the last one in which box-1 was told.

    The pictures show no markers, so nothing but time tells where an overlooked box is.
    """

    def __init__(self) -> None:
        self.hidden = threading.Event()
        self.seen_ns = 0
        self.captured_ns: dict[int, int] = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._work)
        self._thread.start()

    def _work(self) -> None:
        publisher = Publisher(endpoints := Endpoints.of(NetworkConfig()), "detect.0", "b00t")
        subscriber = Subscriber(endpoints)
        subscriber.subscribe(FRAME)
        subscriber.subscribe(TRUTH)
        poller = Poller(subscriber)
        refs: dict[int, FrameRef] = {}
        truths: dict[int, Truth] = {}
        while not self._over.is_set():
            poller.wait(0.1)
            for received in subscriber.receive():
                match received.message:
                    case FrameAnnounced(ref=ref):
                        refs[ref.frame] = ref
                    case Truth() as truth:
                        truths[truth.frame] = truth
            for frame in sorted(refs.keys() & truths.keys()):
                self._tell(publisher, refs.pop(frame), truths.pop(frame))
        publisher.close()
        subscriber.close()

    def _tell(self, publisher: Publisher, ref: FrameRef, truth: Truth) -> None:
        overlooked = self.hidden.is_set() or ref.frame % 4 == 0
        self.captured_ns[ref.frame] = ref.captured_mono_ns
        if not overlooked:
            self.seen_ns = ref.captured_mono_ns
        markers = tuple(
            DetectedMarker(id=marker.id, corners=marker.corners, kind="subpix")
            for item in truth.objects
            if not (overlooked and item.name == "box-1")
            for marker in item.markers
            if marker.visible
        )
        publisher.publish(DETECTIONS, (ref.camera, "markers"), Detections(ref=ref, markers=markers))

    def wide_gaps(self) -> int:
        """Overlooked frames so far that nobody can interpolate: the busy machine left too long a gap around them."""
        told = sorted(frame for frame in self.captured_ns if frame % 4)
        gaps = [(a, b) for a, b in pairwise(told) if self.captured_ns[b] - self.captured_ns[a] > GAP_NS]
        return sum(a < frame < b for frame in self.captured_ns for a, b in gaps)

    def close(self) -> None:
        self._over.set()
        self._thread.join(5)


@pytest.fixture
def running(stack: Stack, tmp_path: Path) -> Iterator[tuple[CommandClient, Overlooking]]:
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG)
    for service in ("control", "store", "label"):
        stack.start_service(service, rig)
    stack.start_service("capture", rig, "--camera", "cam0")
    detector = Overlooking()
    with CommandClient(stack.endpoints, timeout_s=20) as client:
        try:

            def ready() -> bool:
                status = client.request({"command": "status"})
                return "cam0" in status["cameras"] and all(name.startswith("detect") for name in status["missing"])

            wait_for(ready, 60, "all services but detect")
            wait_for(lambda: client.request({"command": "record", "camera": "cam0"})["ok"], 60, "a first sample")
            yield client, detector
        finally:
            detector.close()


@pytest.mark.timeout(300)
def test_an_overlooked_box_is_interpolated_or_refused_by_name(
    running: tuple[CommandClient, Overlooking], stack: Stack, tmp_path: Path
) -> None:
    client, detector = running
    account, recording = record(client, 12)
    assert account["recorded"] == 12
    assert account["refused"].get("incomplete", 0) <= detector.wide_gaps()
    session = SessionReader(tmp_path / "dataset" / "complete")
    labels = [session.label(name) for name in session.samples()]
    assert all(label.complete and not label.missing for label in labels)
    for label in (item for item in labels if item.recording == recording):
        box = next(item for item in label.objects if item.name == "box-1")
        assert box.pose_source == ("interpolated" if label.frame % 4 == 0 else "measured")
        assert box.quality.uncertainty is not None
        erased = {polygon.marker for polygon in label.inpainted.polygons}
        assert erased & set(range(5)), "the markers of an interpolated box are erased"

    detector.hidden.set()
    account, recording = record(client, 2)  # for a second the box must still be there; then it is taken for gone
    assert account["recorded"] == 2
    assert account["refused"]["incomplete"] >= 1
    frames = [label.frame for label in map(session.label, session.samples()) if label.recording == recording]
    assert len(frames) == 2
    assert all(detector.captured_ns[frame] - detector.seen_ns > SEEN_NS for frame in frames)
    label_process = next(process for process in stack.processes if process.name == "services.label")
    wait_for(lambda: label_process.events("sample.refused"), 10, "the log's writer")
    refused = label_process.events("sample.refused")
    assert {event["reason"] for event in refused} == {"incomplete"}
    assert all("box-1 was seen" in event["message"] for event in refused)
    assert client.request({"command": "session", "name": "next"})["ok"]  # and the store lets go of this one
    relabelled_to_the_same_bytes(session.folder)


def relabelled_to_the_same_bytes(folder: Path) -> None:
    """What the stack recorded, interpolated poses too, made again by `tagmill relabel` from the originals."""
    assert main(["relabel", str(folder), "--as-recorded", "--json"]) == 0
    again = folder.with_name("complete-relabelled")
    sources = {
        item.pose_source for name in SessionReader(again).samples() for item in SessionReader(again).label(name).objects
    }
    assert sources == {"measured", "interpolated"}
    for kind in ("rgb", "depth", "original", "label"):
        before = {path.name: path.read_bytes() for path in (folder / kind).iterdir()}
        if kind == "label":  # the one field that says where it is
            before = {
                name: text.replace(b'"session": "complete",', b'"session": "complete-relabelled",')
                for name, text in before.items()
            }
        assert before == {path.name: path.read_bytes() for path in (again / kind).iterdir()}


def record(client: CommandClient, count: int) -> tuple[dict[str, Any], str]:
    """`start` until so many samples are durable: the camera's settled account, and the recording's id."""
    started = client.request({"command": "start", "camera": "cam0", "until_count": count})
    assert started["ok"], started

    def ended() -> bool:
        known = client.request({"command": "status"})["recordings"].get(started["recording"], {})
        return known.get("phase") == "ended"

    wait_for(ended, 60, "the recording to end")
    answer = client.request({"command": "ledger", "recording": started["recording"]})
    account: dict[str, Any] = answer["ledger"]["cameras"]["cam0"]
    settled = account["recorded"] + sum(account["refused"].values()) + sum(account["dropped"].values())
    assert account["captured"] == settled
    return account, started["recording"]
