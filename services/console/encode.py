"""Pictures as JPEG, straight from the ring's slot, on one worker thread: each (camera, kind, size) once a frame."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from common.errors import FrameLostError
from common.frames import FrameReader
from common.labels import Quad
from common.messages import FrameRef
from common.quality import sharpness_of
from services.console.depth import DepthColours

Kind = Literal["rgb", "depth", "after"]
KINDS: tuple[Kind, ...] = ("rgb", "depth", "after")
Bgr = NDArray[np.uint8]
Quads = dict[str, tuple[Quad, ...]]
"""The markers' corners of each object whose sharpness is asked for."""

QUALITY = 75
_NICE = 5
"""A camera's process comes before pictures for a screen."""


@dataclass(frozen=True, slots=True)
class Encoded:
    """One picture in some sizes: divisor to (JPEG, width, height); ``range_mm`` of a depth picture; ``sharpness`` by
    object, of those asked for.
    """

    source: tuple[int, int]
    sizes: dict[int, tuple[bytes, int, int]]
    range_mm: tuple[float, float] | None = None
    sharpness: dict[str, float] = field(default_factory=dict)


class Encoder:
    """The worker thread with the rings that it has mapped. ``encode`` may be called from one thread only."""

    def __init__(self) -> None:
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="console-encode", initializer=be_nice)
        self._readers: dict[tuple[str, Kind], FrameReader] = {}
        self._depths: dict[str, DepthColours] = {}
        self._closed = False

    def encode(
        self, ref: FrameRef, kind: Kind, divisors: Iterable[int], unit_mm: float | None, quads: Quads
    ) -> Future[Encoded]:
        """Begin on a picture; the future raises FrameLostError if it was overwritten (or its ring is gone).

        ``ref`` says where the pixels are. ``unit_mm`` is what a depth picture counts in.
        """
        return self._worker.submit(self._encode, ref, kind, tuple(sorted(set(divisors))), unit_mm, quads)

    def forget(self, camera: str, kind: Kind) -> None:
        """Nobody looks at it any more: let go of its ring."""
        self._worker.submit(self._unmap, camera, kind)

    def close(self) -> None:
        """End the thread, unmap the rings; idempotent."""
        if self._closed:
            return
        self._closed = True
        self._worker.submit(self._unmap_all)
        self._worker.shutdown(wait=True)

    # --- in the thread ------------------------------------------------------------------------------------

    def _encode(
        self, ref: FrameRef, kind: Kind, divisors: tuple[int, ...], unit_mm: float | None, quads: Quads
    ) -> Encoded:
        try:
            reader = self._reader(ref, kind)
            with reader.view(ref.frame) as view:
                if kind == "depth":
                    if view.depth is None:
                        raise FrameLostError(f"{ref.camera} gives no depth")
                    colours = self._depths.setdefault(ref.camera, DepthColours())
                    height, width = view.depth.shape
                    unit = unit_mm or 1.0
                    sizes = {step: _jpeg(colours.paint(view.depth[::step, ::step], unit)) for step in divisors}
                    return Encoded((width, height), sizes, colours.range_mm)
                height, width = view.bgr.shape[:2]
                pictures = {step: _jpeg(_reduced(view.bgr, step)) for step in divisors}
                sharp = {name: value for name, of in quads.items() if (value := sharpness_of(view.bgr, of)) is not None}
                return Encoded((width, height), pictures, sharpness=sharp)
        except FrameLostError:
            # Perhaps its owner died and the mapping is all that is left of the ring: look it up anew next time.
            self._unmap(ref.camera, kind)
            raise

    def _reader(self, ref: FrameRef, kind: Kind) -> FrameReader:
        known = self._readers.get((ref.camera, kind))
        if known is None or known.name != ref.ring:
            self._unmap(ref.camera, kind)
            known = self._readers[ref.camera, kind] = FrameReader(ref.ring)
        return known

    def _unmap(self, camera: str, kind: Kind) -> None:
        reader = self._readers.pop((camera, kind), None)
        if reader is not None:
            reader.close()

    def _unmap_all(self) -> None:
        for camera, kind in list(self._readers):
            self._unmap(camera, kind)


def be_nice() -> None:
    """On Linux niceness belongs to a thread; a machine that forbids it encodes at normal priority."""
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)


def _reduced(picture: Bgr, divisor: int) -> Bgr:
    if divisor == 1:
        return picture
    height, width = picture.shape[:2]
    size = (max(1, width // divisor), max(1, height // divisor))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _jpeg(picture: Bgr) -> tuple[bytes, int, int]:
    done, data = cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, QUALITY))
    if not done:
        raise FrameLostError("the picture can't be encoded")
    return data.tobytes(), picture.shape[1], picture.shape[0]


def jpeg(picture: Bgr, quality: int = QUALITY) -> bytes:
    """A BGR (H, W, 3) picture as JPEG."""
    done, data = cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, quality))
    assert done, "libjpeg takes any uint8 picture"
    return data.tobytes()
