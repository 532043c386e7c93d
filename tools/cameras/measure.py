"""Measures a camera by what its capture process announces, and by some of its pictures."""

from __future__ import annotations

import subprocess
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from common import clock
from common.bus import Endpoints, Poller, Subscriber
from common.config import Rig
from common.errors import FrameLostError
from common.frames import FrameReader
from common.messages import CameraState, FrameAnnounced, FrameRef, ServiceState
from common.quality.depth_holes import depth_at_markers
from common.topics import CAMERA, FRAME, SERVICE
from services.detect.markers import open_detector

LOOK_EVERY_NS = 250_000_000
_DARK, _BRIGHT = 10, 245
_MUCH = 0.05
"""This share of a picture in its darkest or brightest values is lost to the exposure."""


@dataclass(slots=True)
class Measured:
    """One trial. Intervals and drops are of the frames' stamps; ``markers`` of the pictures that were looked at.

    ``exposure``: ``good``, ``dark``, ``bright`` or ``contrast`` (both ends are lost). ``depth_valid``: share, 0..1;
    ``depth_on_markers`` and ``depth_around_markers`` likewise.
    """

    name: str
    driver: str = ""
    phase: str = "opening"
    serial: str | None = None
    size: tuple[int, int] = (0, 0)
    intrinsics_from: str = ""
    nominal_fps: float = 0.0
    frames: int = 0
    seconds: float = 0.0
    fps: float | None = None
    interval_p50_ms: float | None = None
    interval_p95_ms: float | None = None
    interval_longest_ms: float | None = None
    lost: dict[str, int] = field(default_factory=dict)
    not_heard: int = 0
    looked_at: int = 0
    brightness: float | None = None
    dark_share: float | None = None
    bright_share: float | None = None
    exposure: str | None = None
    depth_unit_mm: float | None = None
    depth_valid: float | None = None
    depth_median_mm: float | None = None
    depth_on_markers: float | None = None
    depth_around_markers: float | None = None
    markers: dict[int, int] = field(default_factory=dict)
    snapshot: str | None = None
    last_error: str | None = None
    warnings: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


class _Trial:
    """Hears one camera; ``begin`` is the moment of the first frame."""

    def __init__(self, endpoints: Endpoints, rig: Rig, name: str, seconds: float, snapshot: Path) -> None:
        self.measured = Measured(name)
        self._seconds = seconds
        self._snapshot = snapshot
        self._subscriber = Subscriber(endpoints)
        for topic in (FRAME, CAMERA):
            self._subscriber.subscribe(topic, name)
        self._subscriber.subscribe(SERVICE, f"capture.{name}")
        self._poller = Poller(self._subscriber)
        self._detector = open_detector(rig.config.markers.family, rig.folder)
        self._refs: list[FrameRef] = []
        self._lost_before: dict[str, int] | None = None
        self._reader: FrameReader | None = None
        self._look_ns = 0
        self._levels: list[tuple[float, float, float]] = []
        self._depths: list[tuple[float, float]] = []
        self._holes: list[tuple[float, float]] = []
        self.begin_ns: int | None = None

    @property
    def over(self) -> bool:
        """Measured for long enough, or no further frame will come."""
        if self.begin_ns is None:
            return self.measured.phase == "ended"
        return clock.monotonic_ns() - self.begin_ns > self._seconds * 1e9 or self.measured.phase == "ended"

    def step(self) -> None:
        """Take what has come."""
        self._poller.wait(0.05)
        newest: FrameRef | None = None
        for received in self._subscriber.receive():
            message = received.message
            if isinstance(message, FrameAnnounced):
                newest = message.ref
                self._refs.append(newest)
                self.begin_ns = self.begin_ns or clock.monotonic_ns()
            elif isinstance(message, CameraState):
                self._hear(message)
            elif isinstance(message, ServiceState):
                self.measured.warnings = tuple(warning.message for warning in message.warnings)
        if newest is not None and clock.monotonic_ns() >= self._look_ns:
            self._look(newest)

    def _hear(self, state: CameraState) -> None:
        now = self.measured
        now.phase, now.driver, now.nominal_fps = state.phase, state.driver, state.fps
        now.serial, now.intrinsics_from = state.camera.serial, state.camera.intrinsics_from
        now.size, now.depth_unit_mm = (state.camera.width, state.camera.height), state.depth_unit_mm
        now.last_error = state.last_error
        if self._lost_before is None:
            self._lost_before = state.lost
        lost = {why: count - self._lost_before.get(why, 0) for why, count in state.lost.items()}
        now.lost = {why: count for why, count in lost.items() if count > 0}

    def _look(self, ref: FrameRef) -> None:
        """Look at a picture in place; one that is overwritten meanwhile counts for nothing."""
        try:
            if self._reader is None or self._reader.name != ref.ring:
                self._close_ring()
                self._reader = FrameReader(ref.ring)
            with self._reader.view(ref.frame) as view:
                bgr = view.bgr.copy()
                depth = None if view.depth is None else view.depth.copy()
        except (FrameLostError, FileNotFoundError):
            return
        self._look_ns = clock.monotonic_ns() + LOOK_EVERY_NS
        self.measured.looked_at += 1
        grey = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        dark, bright = float((grey <= _DARK).mean()), float((grey >= _BRIGHT).mean())
        self._levels.append((float(grey.mean()), dark, bright))
        if depth is not None:
            self._depths.append(_depth_of(depth, self.measured.depth_unit_mm or 1.0))
        found = self._detector.detect(grey)
        for marker in found:
            self.measured.markers[marker.id] = self.measured.markers.get(marker.id, 0) + 1
        holes = None if depth is None else depth_at_markers(depth, (np.array(marker.corners) for marker in found))
        if holes is not None:
            self._holes.append(holes)
        if self.measured.snapshot is None and cv2.imwrite(str(self._snapshot), bgr):
            self.measured.snapshot = str(self._snapshot)

    def result(self) -> Measured:
        """What was measured."""
        now = self.measured
        counted = [ref for ref in self._refs if not ref.preview]
        now.frames = len(self._refs)
        if len(counted) > 1:
            times = np.array([ref.captured_mono_ns for ref in counted])
            intervals = np.diff(times) / 1e6
            now.seconds = float(times[-1] - times[0]) / 1e9
            now.fps = (len(counted) - 1) / now.seconds if now.seconds > 0 else None
            now.interval_p50_ms, now.interval_p95_ms = (float(np.percentile(intervals, part)) for part in (50, 95))
            now.interval_longest_ms = float(intervals.max())
            steps = [after.count - before.count for before, after in pairwise(counted)]
            now.not_heard = sum(step - 1 for step in steps if step > 1)
        if self._levels:
            now.brightness, now.dark_share, now.bright_share = (
                float(np.median(part)) for part in zip(*self._levels, strict=True)
            )
            now.exposure = _exposure(now.dark_share, now.bright_share)
        if self._depths:
            now.depth_valid, now.depth_median_mm = _medians(self._depths)
        if self._holes:
            now.depth_on_markers, now.depth_around_markers = _medians(self._holes)
        return now

    def close(self) -> None:
        """Let go of the bus and the ring."""
        self._close_ring()
        self._subscriber.close()

    def _close_ring(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None


def measure(
    endpoints: Endpoints,
    rig: Rig,
    name: str,
    seconds: float,
    wait_s: float,
    snapshot: Path,
    process: subprocess.Popen[bytes] | None = None,
) -> Measured:
    """Hear the camera for ``seconds`` from its first frame on, which may take ``wait_s``.

    Ends early with the capture ``process``. ``snapshot`` gets the first picture that was looked at.
    """
    trial = _Trial(endpoints, rig, name, seconds, snapshot)
    try:
        until_ns = clock.monotonic_ns() + int(wait_s * 1e9)
        while not trial.over and (trial.begin_ns is not None or clock.monotonic_ns() < until_ns):
            trial.step()
            if process is not None and process.poll() is not None:
                break
        return trial.result()
    finally:
        trial.close()


def _depth_of(depth: NDArray[np.uint16], unit_mm: float) -> tuple[float, float]:
    """The share of valid pixels and their median in mm (0 without any)."""
    valid = depth[depth > 0]
    return valid.size / depth.size, float(np.median(valid)) * unit_mm if valid.size else 0.0


def _medians(pairs: list[tuple[float, float]]) -> tuple[float, float]:
    first, second = (float(np.median(part)) for part in zip(*pairs, strict=True))
    return first, second


def _exposure(dark: float, bright: float) -> str:
    if dark > _MUCH and bright > _MUCH:
        return "contrast"
    if bright > _MUCH:
        return "bright"
    return "dark" if dark > 10 * _MUCH else "good"
