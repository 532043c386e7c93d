"""Pictures to files' bytes, in the format that the rig asks for. Depth is always PNG, whatever the format."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.config.dataset import DatasetConfig, PictureFormat
from common.dataset.layout import PictureKind
from services.store.png import Picture, encode_png

_EXTENSIONS: dict[PictureFormat, str] = {"png": "png", "jpeg": "jpg", "webp": "webp"}
_LOSSLESS_WEBP = 101
"""cv2: any quality above 100 is lossless."""
_JPEG_QUALITY = 95


@dataclass(frozen=True, slots=True)
class Coding:
    """How a sample's pictures are written. ``quality`` 1..100; None: WebP is lossless then, JPEG has 95."""

    format: PictureFormat = "png"
    quality: int | None = None

    @classmethod
    def of(cls, config: DatasetConfig) -> Coding:
        """As the rig file has it."""
        return cls(config.format, config.quality)

    def extension(self, kind: PictureKind) -> str:
        """Of the file of such a picture, without the dot."""
        return "png" if kind == "depth" else _EXTENSIONS[self.format]

    def encode(self, kind: PictureKind, picture: Picture) -> bytes:
        """The file's bytes of (H, W, 3) uint8 BGR, or of (H, W) uint16 for ``depth``; raises ValueError for others."""
        if kind == "depth" or self.format == "png":
            return encode_png(picture)
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or picture.size == 0:
            raise ValueError(f"a picture of {picture.dtype} {picture.shape} can't be stored as {self.format}")
        return self._by_cv2(np.asarray(picture, np.uint8))

    def _by_cv2(self, bgr: NDArray[np.uint8]) -> bytes:
        if self.format == "jpeg":
            options = [cv2.IMWRITE_JPEG_QUALITY, self.quality or _JPEG_QUALITY]
        else:
            options = [cv2.IMWRITE_WEBP_QUALITY, self.quality or _LOSSLESS_WEBP]
        done, data = cv2.imencode(f".{_EXTENSIONS[self.format]}", bgr, options)
        if not done:
            raise ValueError(f"cv2 could not encode a picture of {bgr.shape} as {self.format}")
        return data.tobytes()


LOSSLESS = Coding()
