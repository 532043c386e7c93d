"""Messages about cameras and frames (published by capture)."""

from __future__ import annotations

from typing import Literal

from common.labels import CameraLabel, Part, Point, Quad, Vector3, Window
from common.messages.base import Message


class FrameRef(Part):
    """Where a frame's pixels are and what they are.

    ``frame`` is the ring's sequence number in this life (``boot``) of the capture process, from 1.
    ``count`` counts the captured frames of that life; a preview frame (a waiting file camera) has 0 and
    is not counted as captured. ``source_name`` is the picture's file name or the video's position.
    """

    camera: str
    boot: str
    ring: str
    frame: int
    count: int
    captured_mono_ns: int
    captured_wall_ns: int
    device_ns: int | None = None
    source_name: str | None = None
    preview: bool = False


class FrameAnnounced(Message):
    """A frame is in the ring."""

    ref: FrameRef


CameraPhase = Literal["opening", "streaming", "waiting", "ended", "stalled", "lost"]


class CameraState(Message):
    """A camera describes itself, once a second and at every change.

    ``waiting``: a file camera that plays when a recording starts; ``lost``: reconnecting;
    ``stalled``: the driver doesn't come back from a call. ``newest_mono_ns`` is when the newest frame was taken.
    ``captured`` is the ``count`` of the newest frame; ``played_for`` the recording that a file camera plays
    (or played) for, with ``play_first`` the count of that pass's first frame. ``paced``: the camera waits for
    the label of a frame before it gives the next.
    """

    boot: str
    phase: CameraPhase
    driver: str
    ring: str
    camera: CameraLabel
    fps: float
    depth_unit_mm: float | None = None
    captured: int = 0
    lost: dict[str, int] = {}
    last_error: str | None = None
    played_for: str | None = None
    play_first: int = 0
    paced: bool = False
    newest_mono_ns: int = 0


class TrueMarker(Part):
    """A marker as the renderer placed it; ``visible`` = its side faces the camera and it is inside the picture."""

    id: int
    corners: Quad
    visible: bool


class TrueObject(Part):
    """An object as the renderer placed it: pose (object to camera frame), eight corners (px), window, distance."""

    name: str
    rvec: Vector3
    tvec_mm: Vector3
    corners: tuple[Point, ...]
    window: Window
    distance_mm: float
    markers: tuple[TrueMarker, ...]


class Truth(Message):
    """Ground truth of a synthetic frame."""

    camera: str
    boot: str
    frame: int
    objects: tuple[TrueObject, ...]
