"""Tracking against searching each frame, on a rendered sequence and on a real video, interleaved."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from common.markers import family
from common.messages import DetectedMarker
from services.detect.markers import open_detector
from services.detect.tracking import Tracker
from tools.bench.detect_cases import SEARCHED
from tools.bench.marker_scenes import sequence

Grey = NDArray[np.uint8]

FRAMES = 60
VIDEO = "wpical/two_tags.mp4"


@dataclass
class Tracked:
    """One sequence. ``other_ids``: frames whose ids differ from the full search's; ``apart_px``: corners' distances."""

    name: str
    frames: int = 0
    searches: int = 0
    other_ids: int = 0
    apart_px: list[float] = field(default_factory=list)
    search_ms: list[float] = field(default_factory=list)
    track_ms: list[float] = field(default_factory=list)

    @property
    def ratio(self) -> float:
        """Time of tracking, its full searches included, against searching each frame."""
        return sum(self.track_ms) / max(sum(self.search_ms), 1e-9)


def track(data: Path | None, seed: int) -> list[Tracked]:
    """The rendered sequence, and the video where it is there."""
    searched = family(SEARCHED, Path())
    results = [_follow("rendered", (scene.grey for scene in sequence(searched, seed, FRAMES)))]
    if data is not None and (data / VIDEO).is_file():
        results.append(_follow(VIDEO, _frames(data / VIDEO)))
    return results


def _follow(name: str, frames: Iterator[Grey]) -> Tracked:
    detector = open_detector(SEARCHED, Path())
    tracker = Tracker(detector)
    result = Tracked(name)
    for grey in frames:
        began = time.process_time_ns()
        searched = detector.detect(grey)
        between = time.process_time_ns()
        tracked = tracker.detect(grey)
        result.track_ms.append((time.process_time_ns() - between) / 1e6)
        result.search_ms.append((between - began) / 1e6)
        result.frames += 1
        _compare(searched, tracked, result)
    result.searches = tracker.searches
    return result


def _compare(searched: list[DetectedMarker], tracked: list[DetectedMarker], result: Tracked) -> None:
    one, other = (sorted(these, key=lambda m: (m.id, m.corners)) for these in (searched, tracked))
    if [m.id for m in one] != [m.id for m in other]:
        result.other_ids += 1
        return
    for mine, its in zip(one, other, strict=True):
        result.apart_px.append(float(np.linalg.norm(np.array(mine.corners) - np.array(its.corners), axis=1).mean()))


def _frames(path: Path) -> Iterator[Grey]:
    video = cv2.VideoCapture(str(path))
    while True:
        more, bgr = video.read()
        if not more:
            return
        yield np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
