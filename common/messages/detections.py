"""What a detector saw in a frame. Several named sources may publish these; ``markers`` is tagmill's own."""

from __future__ import annotations

from common.evidence import DetectedMarker as DetectedMarker
from common.labels import DetectedWindow, LeftOut, Missing, ObjectLabel
from common.messages.base import Message
from common.messages.frames import FrameRef

MARKERS = "markers"


class Detections(Message):
    """One source's detections in one frame; ``skipped`` counts, since start, frames it passed over (why)."""

    ref: FrameRef
    source: str = MARKERS
    markers: tuple[DetectedMarker, ...] = ()
    windows: tuple[DetectedWindow, ...] = ()
    took_ns: int = 0
    skipped: dict[str, int] = {}


class Labels(Message):
    """The labelled frame: objects with poses, and what gave no object."""

    ref: FrameRef
    objects: tuple[ObjectLabel, ...]
    left_out: tuple[LeftOut, ...] = ()
    missing: tuple[Missing, ...] = ()
    took_ns: int = 0


class Preview(Message):
    """An inpainted picture lies in the label process's preview ring (``shown``); ``of`` is the camera's frame."""

    shown: FrameRef
    of: FrameRef
