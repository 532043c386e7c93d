"""PNG, by the fastest encoder that is installed for the kind of picture; whichever it is, the file is standard PNG.

Colour: fpng (https://github.com/richgel999/fpng), else isa-l's deflate, else cv2. 16 bit: fpng where the depth is
noisy, isa-l's deflate where it is smooth, else cv2. Measured on 1280x720 by `tagmill bench record`.
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
_LENGTH_BYTES = 4
"""Before the name of a chunk."""
_GREY, _RGB = 0, 2
_SUB, _UP = 1, 2
"""PNG's filters: minus the pixel to the left, minus the one above (PNG specification, section 9.2)."""
_LEVEL = 1
_SMOOTH, _LOOKED_AT = 0.6, 16
"""Depth of which this share of pixels equals the one above, looked at in one row of so many: there isa-l is faster,
and its files are half as large. Noisier depth takes it 1.6 times as long as fpng, whose files are a quarter to a half
larger.
"""


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
    """Which encoder serves ``colour``, ``noisy depth`` and ``smooth depth``."""
    deflate = "cv2" if _ISAL is None else "isal"
    noisy = deflate if _FPNG is None else "fpng"
    return {"colour": noisy, "noisy depth": noisy, "smooth depth": deflate}


def _colour(bgr: Bytes) -> bytes:
    if _FPNG is not None:
        return bytes(_FPNG.from_cv2(np.ascontiguousarray(bgr)))
    if _ISAL is None:
        return _by_cv2(bgr)
    height, width = bgr.shape[:2]
    rows = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8).reshape(height, width * 3)
    return _file(_minus_above(rows), width, height, 8, _RGB, _ISAL.compress, _ISAL.crc32)


def _deep(picture: NDArray[np.uint16]) -> bytes:
    height, width = picture.shape
    if _FPNG is not None and width % 2 == 0 and not _is_smooth(picture):
        # Two pixels of 16 bits go as one of four bytes: fpng knows no others, and its filters don't depend on it.
        quads = picture.astype(">u2").view(np.uint8).reshape(height, width // 2, 4)
        return _as_grey(_FPNG.from_ndarray(quads), width, height)
    if _ISAL is None:
        return _by_cv2(picture)
    rows = picture.astype(">u2").view(np.uint8).reshape(height, width * 2)
    return _file(_minus_left(rows, 2), width, height, 16, _GREY, _ISAL.compress, _ISAL.crc32)


def _is_smooth(picture: NDArray[np.uint16]) -> bool:
    below = picture[1::_LOOKED_AT]
    above = picture[::_LOOKED_AT][: len(below)]
    return int(np.count_nonzero(below == above)) >= _SMOOTH * below.size


def _as_grey(file: bytes, width: int, height: int) -> bytes:
    """fpng's file with another header, and without its own chunk, by which its decoder knows pixels of four bytes."""
    data = file.index(b"IDAT", len(_SIGNATURE)) - _LENGTH_BYTES
    return b"".join((_SIGNATURE, _header(width, height, 16, _GREY), memoryview(file)[data:]))


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
    data = _chunk(b"IDAT", compress(rows, _LEVEL), crc32)
    return b"".join((_SIGNATURE, _header(width, height, bits, colour_type), data, _chunk(b"IEND", b"", crc32)))


def _header(width: int, height: int, bits: int, colour_type: int) -> bytes:
    return _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour_type, 0, 0, 0), zlib.crc32)


def _chunk(name: bytes, data: bytes, crc32: Callable[[bytes, int], int]) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", crc32(data, zlib.crc32(name)))


def _by_cv2(picture: Picture) -> bytes:
    done, data = cv2.imencode(".png", picture)
    if not done:
        raise ValueError(f"cv2 could not encode a picture of {picture.dtype} {picture.shape}")
    return data.tobytes()
