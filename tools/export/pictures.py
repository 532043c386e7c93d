"""The picture's way into the export: unchanged, or undistorted, resized, letterboxed, encoded anew."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from common.bounded import TooLargeError, read_bytes
from common.errors import DatasetError
from common.geometry import CameraModel
from common.pictures import MOST_BYTES, decode

Pixels = NDArray[np.integer[Any] | np.floating[Any]]
Array = NDArray[np.float64]
Fit = Literal["stretch", "letterbox"]
_GREY = 114
"""Of the letterbox's bars: what the YOLO family pads with."""
_PNG_LEVEL = 3
_PNG_OF_RAW, _JPG_OF_RAW = 0.55, 0.12
"""Guesses of a file's size, as a share of the raw pixels', to tell the need of disk before anything is made."""


@dataclass(frozen=True, eq=False)
class Change:
    """What is done to the pictures of one camera. ``camera``: as stored; ``size``: width, height of the result.

    ``extension`` is the result's; where nothing changes, not even the format, the picture is linked.
    """

    camera: CameraModel
    size: tuple[int, int]
    fit: Fit
    undistort: bool
    extension: str
    stored_as: str
    quality: int

    @property
    def keeps(self) -> bool:
        """Whether the picture stays as it is, byte for byte."""
        return (
            not self.undistort
            and self.size == (self.camera.width, self.camera.height)
            and self.extension == self.stored_as
        )

    @property
    def key(self) -> str:
        """Names the change."""
        if self.keeps:
            return "as-stored"
        quality = f":q{self.quality}" if self.extension == "jpg" else ""
        lens = f":{self.camera.matrix.tolist()}:{self.camera.distortion.tolist()}" if self.undistort else ""
        return f"{self.size[0]}x{self.size[1]}:{self.fit}{lens}:{self.extension}{quality}"

    @property
    def scale(self) -> tuple[float, float]:
        """Exported pixels for each stored one, across and down."""
        across, down = self.size[0] / self.camera.width, self.size[1] / self.camera.height
        if self.fit == "stretch":
            return across, down
        width, height = self.inner
        return width / self.camera.width, height / self.camera.height

    @property
    def inner(self) -> tuple[int, int]:
        """Width and height of the picture within the bars of the letterbox."""
        if self.fit == "stretch":
            return self.size
        scale = min(self.size[0] / self.camera.width, self.size[1] / self.camera.height)
        return max(round(self.camera.width * scale), 1), max(round(self.camera.height * scale), 1)

    @property
    def offset(self) -> tuple[int, int]:
        """Width of the left bar, height of the upper one."""
        width, height = self.inner
        return (self.size[0] - width) // 2, (self.size[1] - height) // 2

    def pixels(self, stored: Array) -> Array:
        """Where pixels (N, 2) of the stored picture are in the exported one; without ``undistort``."""
        scale, offset = np.array(self.scale), np.array(self.offset)
        return np.asarray((stored + 0.5) * scale - 0.5 + offset)

    def exported_camera(self) -> CameraModel:
        """The camera that would have taken the exported picture."""
        (sx, sy), (left, top) = self.scale, self.offset
        move = np.array([[sx, 0, (sx - 1) / 2 + left], [0, sy, (sy - 1) / 2 + top], [0, 0, 1]])
        distortion = np.zeros(5) if self.undistort else self.camera.distortion
        model: Literal["pinhole", "fisheye"] = "pinhole" if self.undistort else self.camera.model
        return CameraModel(self.size[0], self.size[1], move @ self.camera.matrix, distortion, model=model)

    def guess_bytes(self) -> int:
        """About how large the exported picture will be."""
        share = _JPG_OF_RAW if self.extension == "jpg" else _PNG_OF_RAW
        return int(self.size[0] * self.size[1] * 3 * share)

    def colour(self, path: Path) -> bytes:
        """The exported picture of a stored one, encoded; raises DatasetError if it can't be read."""
        bgr = self._fitted(_read(path, cv2.IMREAD_COLOR), cv2.INTER_AREA, _GREY)
        if self.extension == "jpg":
            return encoded(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, self.quality])
        return png(bgr)

    def depth(self, path: Path) -> NDArray[np.uint16]:
        """The depth picture (H, W) uint16 that goes with the exported one; never interpolated."""
        return np.asarray(self._fitted(_read(path, cv2.IMREAD_UNCHANGED), cv2.INTER_NEAREST, 0), dtype=np.uint16)

    def _fitted(self, picture: Pixels, how: int, bars: int) -> Pixels:
        if picture.shape[:2] != (self.camera.height, self.camera.width):
            raise DatasetError(
                f"a picture has {picture.shape[1]}x{picture.shape[0]} pixels, its label says "
                f"{self.camera.width}x{self.camera.height}; 'tagmill dataset delete' takes such a sample away"
            )
        if self.undistort:
            nearest = how == cv2.INTER_NEAREST
            across, down = _maps(self.camera)
            picture = cv2.remap(picture, across, down, cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR)
        if self.inner != (self.camera.width, self.camera.height):
            larger = self.inner[0] > self.camera.width
            how = cv2.INTER_LINEAR if larger and how == cv2.INTER_AREA else how
            # INTER_NEAREST_EXACT keeps the pixel centres that the labels are scaled by; INTER_NEAREST doesn't.
            how = cv2.INTER_NEAREST_EXACT if how == cv2.INTER_NEAREST else how
            picture = cv2.resize(picture, self.inner, interpolation=how)
        if self.inner != self.size:
            (left, top), (width, height) = self.offset, self.inner
            right, bottom = self.size[0] - width - left, self.size[1] - height - top
            value = (bars, bars, bars)
            picture = cv2.copyMakeBorder(picture, top, bottom, left, right, cv2.BORDER_CONSTANT, value=value)
        return picture


def png(picture: Pixels) -> bytes:
    """Encode as PNG."""
    return encoded(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL])


def encoded(extension: str, picture: Pixels, options: list[int]) -> bytes:
    """Encode a picture."""
    done, data = cv2.imencode(extension, picture, options)
    if not done:
        raise DatasetError(f"a picture can't be encoded as {extension}")
    return data.tobytes()


_kept: dict[bytes, tuple[NDArray[np.float32], NDArray[np.float32]]] = {}
_lock = threading.Lock()


def _maps(camera: CameraModel) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """For each pixel of the undistorted picture, where it is in the stored one; kept by camera."""
    numbers = [camera.width, camera.height, *camera.matrix.ravel(), *camera.distortion]
    name = camera.model.encode() + np.array(numbers, dtype=np.float64).tobytes()
    with _lock:
        if name not in _kept:
            x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
            flat = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]) @ np.linalg.inv(camera.matrix).T
            pixels, _ = camera.project(flat * 1000.0)
            across, down = (pixels[:, i].reshape(x.shape).astype(np.float32) for i in range(2))
            _kept[name] = across, down
        return _kept[name]


def _read(path: Path, flags: int) -> Pixels:
    try:
        data = read_bytes(path, MOST_BYTES)
    except (OSError, TooLargeError) as error:
        raise DatasetError(f"{path} can't be read: {getattr(error, 'strerror', None) or error}") from error
    picture = decode(data, flags)
    if picture is None or picture.dtype not in (np.uint8, np.uint16):
        raise DatasetError(f"{path} is no picture that can be read; it is damaged", code="damaged")
    return picture
