"""Cameras that are gone for good are forgotten, with all that was mapped or made for them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from common import clock
from common.bus import Endpoints
from common.config.models import NetworkConfig
from common.frames import FrameWriter, segment_name
from common.labels import CameraLabel
from common.log import get
from common.messages import Answer, CameraState, Detections, FrameRef
from services.label import cameras, preview
from services.label.cameras import Camera
from services.label.labelling import ALONE
from services.label.preview import Previews
from services.label.roster import Roster
from services.label.samples import Samples

LABEL = CameraLabel(name="cam0", width=32, height=24, matrix=((30, 0, 16), (0, 30, 12), (0, 0, 1)), distortion=())


class Worker:
    """Takes jobs and does none."""

    def __init__(self) -> None:
        self.jobs: list[Any] = []

    def submit(self, job: Any, *, first: bool = False) -> None:
        self.jobs.append(job)


@pytest.fixture
def prefix() -> str:
    return Endpoints.of(NetworkConfig()).prefix


@pytest.fixture
def ring(prefix: str) -> Iterator[str]:
    """A camera's ring with a frame in it."""
    writer = FrameWriter(segment_name(prefix, "capture.cam0", "boot"), 32, 24, False, 4)
    writer.write(np.zeros((24, 32, 3), np.uint8), None)
    yield writer.name
    writer.close()


def state(ring: str) -> CameraState:
    return CameraState(boot="boot", phase="streaming", driver="synthetic", ring=ring, camera=LABEL, fps=10)


def detections(ring: str) -> Detections:
    now, wall = clock.monotonic_ns(), clock.wall_ns()
    ref = FrameRef(camera="cam0", boot="boot", ring=ring, frame=1, count=1, captured_mono_ns=now, captured_wall_ns=wall)
    return Detections(ref=ref)


def read_only_maps(ring: str) -> int:
    """How often this process has the ring mapped for reading (the writer's own map is for writing, too)."""
    lines = Path("/proc/self/maps").read_text().splitlines()
    return sum(ring in line and line.split()[1].startswith("r--") for line in lines)


def segments(prefix: str, of: str) -> list[str]:
    return [path.name for path in Path("/dev/shm").glob(f"tagmill-{prefix}-{of}*")]


def test_a_camera_that_is_gone_for_good_is_forgotten_and_its_ring_unmapped(
    ring: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    roster = Roster(0, 1, 4, get())
    roster.hear_camera(state(ring))
    (camera,) = roster
    with camera.pixels(detections(ring).ref) as view:
        assert view.bgr.shape == (24, 32, 3)
    assert read_only_maps(ring) == 1
    roster.let_go(lambda _: False)
    assert roster.names == ("cam0",), "it was heard just now"
    monkeypatch.setattr(cameras, "GONE_AFTER_NS", -1)
    roster.let_go(lambda _: True)
    assert roster.names == ("cam0",), "a recording still runs on it"
    roster.let_go(lambda _: False)
    assert roster.names == ()
    assert read_only_maps(ring) == 0
    roster.hear_camera(state(ring))
    assert roster.names == ("cam0",), "it came back"
    roster.close()


def test_its_sample_ring_goes_once_all_its_samples_have_their_answer(ring: str, prefix: str) -> None:
    camera, worker = Camera(state(ring), 4), Worker()
    samples = Samples(prefix, "label.0", "boot", 2, keep_original=False)
    sample = samples.begin(camera, detections(ring), ALONE, [], worker)  # type: ignore[arg-type]
    samples.keep_only(())
    assert segments(prefix, "label.0.cam0"), "the store may still have to read it"
    assert samples.answered(Answer(key=sample.name)) is not None
    samples.keep_only(("cam0",))
    assert segments(prefix, "label.0.cam0")
    samples.keep_only(())
    assert segments(prefix, "label.0.cam0") == []
    samples.close()
    camera.close()


def test_a_preview_that_nobody_watches_ends_also_when_no_further_frame_comes(
    ring: str, prefix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera, worker = Camera(state(ring), 4), Worker()
    previews = Previews(prefix, "label.0", "boot", lambda _: None)
    previews.lease("cam0")
    previews.begin(camera, detections(ring), ALONE, worker)  # type: ignore[arg-type]
    previews.tidy()
    assert len(segments(prefix, "label.0.cam0.preview")) == 2
    monkeypatch.setattr(preview, "LEASE_NS", -1)
    previews.lease("cam0")
    previews.tidy()
    assert segments(prefix, "label.0.cam0.preview"), "the worker is still at it"
    (job,) = worker.jobs
    assert previews.finished(job, None)
    previews.tidy()
    assert segments(prefix, "label.0.cam0.preview") == []
    previews.close()
    camera.close()
