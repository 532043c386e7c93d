"""PNG, by the fastest encoder that is installed for the kind of picture; whichever it is, the file is standard PNG.

Colour: fpng (https://github.com/richgel999/fpng), else isa-l's deflate, else cv2. 16 bit: isa-l's deflate, else cv2.
Measured on 1280x720 by `tagmill bench record`.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from importlib import import_module
from types import ModuleType

import cv2
import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Picture = Bytes | NDArray[np.uint16]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY, _RGB = 0, 2
_SUB, _UP = 1, 2
"""PNG's filters: minus the pixel to the left, minus the one above (PNG specification, section 9.2)."""
_LEVEL = 1


def _optional(name: str) -> ModuleType | None:
    try:
        return import_module(name)
    except ImportError:
        return None


_FPNG, _ISAL = _optional("fpng"), _optional("isal.isal_zlib")


def encode_png(picture: Picture) -> bytes:
    """A lossless PNG of (H, W, 3) uint8 BGR or (H, W) uint16, as the file's bytes; raises ValueError for others."""
    if picture.size == 0:
        raise ValueError(f"a picture of {picture.dtype} {picture.shape} can't be stored as PNG")
    if picture.dtype == np.uint8 and picture.ndim == 3 and picture.shape[2] == 3:
        return _colour(np.asarray(picture, np.uint8))
    if picture.dtype == np.uint16 and picture.ndim == 2:
        return _deep(np.asarray(picture, np.uint16))
    raise ValueError(f"a picture of {picture.dtype} {picture.shape} can't be stored as PNG")


def encoders() -> dict[str, str]:
    """Which encoder serves ``colour`` and which ``depth``."""
    deflate = "cv2" if _ISAL is None else "isal"
    return {"colour": deflate if _FPNG is None else "fpng", "depth": deflate}


def _colour(bgr: Bytes) -> bytes:
    if _FPNG is not None:
        return bytes(_FPNG.from_cv2(np.ascontiguousarray(bgr)))
    if _ISAL is None:
        return _by_cv2(bgr)
    height, width = bgr.shape[:2]
    rows = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8).reshape(height, width * 3)
    return _file(_minus_above(rows), width, height, 8, _RGB, _ISAL.compress, _ISAL.crc32)


def _deep(picture: NDArray[np.uint16]) -> bytes:
    if _ISAL is None:
        return _by_cv2(picture)
    height, width = picture.shape
    rows = picture.astype(">u2").view(np.uint8).reshape(height, width * 2)
    return _file(_minus_left(rows, 2), width, height, 16, _GREY, _ISAL.compress, _ISAL.crc32)


def _minus_above(rows: Bytes) -> Bytes:
    out = _filtered(rows, _UP)
    out[0, 1:] = rows[0]
    np.subtract(rows[1:], rows[:-1], out=out[1:, 1:])
    return out


def _minus_left(rows: Bytes, pixel: int) -> Bytes:
    out = _filtered(rows, _SUB)
    out[:, 1 : 1 + pixel] = rows[:, :pixel]
    np.subtract(rows[:, pixel:], rows[:, :-pixel], out=out[:, 1 + pixel :])
    return out


def _filtered(rows: Bytes, kind: int) -> Bytes:
    """Room for filtered rows, each with the number of its filter in front."""
    out = np.empty((rows.shape[0], rows.shape[1] + 1), np.uint8)
    out[:, 0] = kind
    return out


def _file(
    rows: Bytes,
    width: int,
    height: int,
    bits: int,
    colour_type: int,
    compress: Callable[[Bytes, int], bytes],
    crc32: Callable[[bytes, int], int],
) -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", crc32(data, zlib.crc32(name)))

    head = struct.pack(">IIBBBBB", width, height, bits, colour_type, 0, 0, 0)
    return b"".join(
        (_SIGNATURE, chunk(b"IHDR", head), chunk(b"IDAT", compress(rows, _LEVEL)), chunk(b"IEND", b"")),
    )


def _by_cv2(picture: Picture) -> bytes:
    done, data = cv2.imencode(".png", picture)
    if not done:
        raise ValueError(f"cv2 could not encode a picture of {picture.dtype} {picture.shape}")
    return data.tobytes()
