"""The one table of topics. Code, liveness, the docs page and a test are driven by it; nobody else spells a topic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from common.messages import (
    CameraState,
    Detections,
    FrameAnnounced,
    Labels,
    Message,
    Preview,
    RecordingState,
    SamplesChanged,
    ServiceState,
    Shares,
    Truth,
)

Delivery = Literal["latest", "every"]


@dataclass(frozen=True, slots=True)
class Topic:
    """A row of the table.

    ``name`` is the first part of the topic on the wire; the parts named in ``keys`` follow, each after a
    ``/`` (``frame/cam0``). ``rate_hz`` is the nominal rate a key, None = the camera's frame rate, and
    without a key when it happens.
    ``delivery``: ``latest`` = a reader that lags gets only the newest of each key, ``every`` = all, in order.
    """

    name: str
    keys: tuple[str, ...]
    message: type[Message]
    publisher: str
    rate_hz: float | None
    delivery: Delivery
    purpose: str

    def key(self, *parts: str) -> bytes:
        """The topic on the wire for these key parts; with fewer parts, a prefix for subscribing to all below."""
        if len(parts) > len(self.keys):
            raise ValueError(f"topic {self.name} has {len(self.keys)} key parts, got {parts}")
        end = "" if len(parts) == len(self.keys) else "/"
        return ("/".join((self.name, *parts)) + end).encode()


FRAME = Topic("frame", ("camera",), FrameAnnounced, "capture", None, "latest", "a frame is in the camera's ring")
CAMERA = Topic("camera", ("camera",), CameraState, "capture", 1.0, "latest", "a camera describes itself")
TRUTH = Topic("truth", ("camera",), Truth, "capture", None, "every", "ground truth of a synthetic frame")
DETECTIONS = Topic(
    "detections",
    ("camera", "source"),
    Detections,
    "detect",
    None,
    "every",
    "what a named source saw in a frame",
)
LABELS = Topic("labels", ("camera",), Labels, "label", None, "every", "objects with pose, corners, window, distance")
PREVIEW = Topic("preview", ("camera",), Preview, "label", None, "latest", "an inpainted picture, while one watches")
RECORDING = Topic("recording", ("camera", "recording"), RecordingState, "label", 1.0, "latest", "a recording's account")
SAMPLES = Topic("samples", (), SamplesChanged, "store", None, "every", "samples were stored, deleted or restored")
SERVICE = Topic("service", ("service",), ServiceState, "every service", 1.0, "latest", "heartbeat, rates, drops")
SHARES = Topic("shares", (), Shares, "control", 1.0, "latest", "which instance serves which camera")

TOPICS: tuple[Topic, ...] = (FRAME, CAMERA, TRUTH, DETECTIONS, LABELS, PREVIEW, RECORDING, SAMPLES, SERVICE, SHARES)


def topic_of(wire: bytes) -> Topic | None:
    """The row for a topic as it came over the wire, None for an unknown one."""
    name = wire.split(b"/", 1)[0].decode("ascii", "replace")
    return next((topic for topic in TOPICS if topic.name == name), None)
