"""Reading picture files: colour, depth, bit depth, transparency and EXIF orientation right; natural order."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from common import MOST_PIXELS
from common.bounded import TooLargeError, read_bytes
from common.errors import CameraError
from common.pictures import MOST_BYTES, decode
from services.capture.cameras.base import FrameSkippedError

PICTURES = frozenset(
    {".png", ".jpg", ".jpeg", ".jpe", ".bmp", ".dib", ".webp", ".tif", ".tiff", ".ppm", ".pgm", ".pnm", ".jp2", ".avif"}
)
_ORIENTATION = 0x0112
_SHORT = 3
_ROLE = re.compile(r"^(rgb|color|colour|depth)[_-]", re.IGNORECASE)
# EXIF orientation: how often to turn (clockwise, by 90 degrees), and whether to mirror left and right afterwards.
_TURNS = {
    1: (0, False),
    2: (0, True),
    3: (2, False),
    4: (2, True),
    5: (1, True),
    6: (1, False),
    7: (3, True),
    8: (3, False),
}
_ROTATE = {1: cv2.ROTATE_90_CLOCKWISE, 2: cv2.ROTATE_180, 3: cv2.ROTATE_90_COUNTERCLOCKWISE}

Colour = NDArray[np.uint8]
Depth = NDArray[np.uint16]


def read_picture(path: Path) -> Colour:
    """The picture upright as (H, W, 3) uint8 BGR.

    16 bits are scaled to 8 by their full range, grey becomes BGR, transparent pixels are shown on white (paper),
    EXIF orientation is applied. Raises FrameSkippedError for a file that can't be read as a picture.
    """
    raw = _bytes_of(path)
    try:
        picture, kinds, chunks = cv2.imdecodeWithMetadata(raw, flags=cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        too_large = "IO_MAX_IMAGE" in error.err
        why = f"it claims more than {MOST_PIXELS >> 20} megapixels" if too_large else f"it is damaged ({error.err})"
        raise _unreadable(path, why) from error
    if picture is None:
        raise _unreadable(path, "it is damaged or of an unknown format")
    metadata = [
        bytes(np.asarray(chunk)) for kind, chunk in zip(kinds, chunks, strict=True) if kind == cv2.IMAGE_METADATA_EXIF
    ]
    turned = _upright(_bgr(np.asarray(picture), path), exif_orientation(metadata[0]) if metadata else 1)
    return np.ascontiguousarray(turned)


def read_depth(path: Path) -> Depth:
    """A depth picture as (H, W) uint16; raises FrameSkippedError for anything but one 16-bit channel."""
    picture = decode(_bytes_of(path), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise _unreadable(path, "it is damaged or of an unknown format")
    if picture.dtype != np.uint16 or picture.ndim != 2:
        channels = 1 if picture.ndim == 2 else picture.shape[2]
        raise FrameSkippedError(
            f"{path} is no depth picture: it has {channels} channel(s) of {picture.dtype}, depth is one of uint16",
            "unreadable",
        )
    return np.ascontiguousarray(picture, dtype=np.uint16)


def exif_orientation(exif: bytes) -> int:
    """The orientation (1 to 8) that EXIF data name; 1, upright, where they name none or make no sense."""
    data = exif.removeprefix(b"Exif\0\0")
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4])
    if order is None:
        return 1
    try:
        (start,) = struct.unpack_from(order + "I", data, 4)
        (entries,) = struct.unpack_from(order + "H", data, start)
        for place in range(start + 2, start + 2 + 12 * entries, 12):
            tag, kind, count, value = struct.unpack_from(order + "HHIH", data, place)
            if tag == _ORIENTATION and kind == _SHORT and count == 1:
                return value if value in _TURNS else 1
    except struct.error:
        return 1
    return 1


def natural_key(path: Path) -> tuple[tuple[int, int, str], ...]:
    """A sort key by which ``img2`` comes before ``img10``."""
    parts = re.split(r"(\d+)", str(path))
    return tuple((0, int(part), part) if part.isdigit() else (1, 0, part.casefold()) for part in parts)


def list_pictures(path: Path) -> list[Path]:
    """The pictures of a folder (not of folders in it), of a glob, or the one picture, in natural order.

    Raises CameraError if there are none.
    """
    if any(sign in str(path) for sign in "*?[") and not path.exists():
        anchor, pattern = _split_glob(path)
        found = [file for file in anchor.glob(pattern) if file.is_file()] if anchor.is_dir() else []
    elif path.is_dir():
        found = [file for file in path.iterdir() if file.is_file() and not file.name.startswith(".")]
    elif path.is_file():
        found = [path]
    else:
        raise CameraError(f"{path} does not exist; check the camera's path (it is relative to the rig file's folder)")
    pictures = sorted((file for file in found if file.suffix.lower() in PICTURES), key=natural_key)
    if not pictures:
        raise CameraError(f"{path} names no picture (of {', '.join(sorted(PICTURES))})")
    return pictures


def match_depth(pictures: Sequence[Path], depths: Sequence[Path]) -> list[Path | None]:
    """The depth picture of each picture: the one of the same stem, or by order where no stem fits any.

    A leading ``rgb_``, ``color_`` or ``depth_`` doesn't count. Raises CameraError if neither way fits.
    """
    by_stem = {_stem(depth): depth for depth in depths}
    matched = [by_stem.get(_stem(picture)) for picture in pictures]
    if any(matched):
        return matched
    if len(depths) == len(pictures):
        return list(depths)
    raise CameraError(
        f"{len(depths)} depth pictures for {len(pictures)} pictures and no two of the same name; "
        "give each pair the same stem, or as many depth pictures as pictures"
    )


def _stem(path: Path) -> str:
    return _ROLE.sub("", path.stem)


def _split_glob(path: Path) -> tuple[Path, str]:
    """The longest leading folder without wildcards, and the rest as a pattern."""
    parts = path.parts
    first = next(index for index, part in enumerate(parts) if any(sign in part for sign in "*?["))
    return Path(*parts[:first]), str(Path(*parts[first:]))


def _bytes_of(path: Path) -> NDArray[np.uint8]:
    try:
        raw = np.frombuffer(read_bytes(path, MOST_BYTES), np.uint8)
    except TooLargeError as error:
        raise _unreadable(path, str(error)) from error
    except OSError as error:
        if not path.parent.is_dir():
            raise CameraError(f"the folder {path.parent} is gone") from error
        raise _unreadable(path, error.strerror or str(error)) from error
    if not raw.size:
        raise _unreadable(path, "it is empty")
    return raw


def _unreadable(path: Path, why: str) -> FrameSkippedError:
    return FrameSkippedError(f"{path} can't be read: {why}", "unreadable")


def _bgr(picture: NDArray[np.integer[Any]], path: Path) -> Colour:
    if picture.dtype == np.uint16:
        picture = np.asarray(cv2.convertScaleAbs(picture, alpha=255 / 65535), dtype=np.uint8)
    if picture.dtype != np.uint8:
        raise _unreadable(path, f"its pixels are {picture.dtype}; only pictures of 8 or 16 bits are")
    channels = 1 if picture.ndim == 2 else picture.shape[2]
    if channels == 1:
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    if channels == 4:
        return _on_white(np.asarray(picture, dtype=np.uint8))
    if channels != 3:
        raise _unreadable(path, f"it has {channels} channels")
    return np.asarray(picture, dtype=np.uint8)


def _on_white(picture: Colour) -> Colour:
    opacity = picture[:, :, 3:].astype(np.uint16)
    if opacity.min() == 255:
        return np.ascontiguousarray(picture[:, :, :3])
    mixed = picture[:, :, :3] * opacity + 255 * (255 - opacity)
    return ((mixed + 127) // 255).astype(np.uint8)


def _upright(picture: Colour, orientation: int) -> Colour:
    turns, mirrored = _TURNS[orientation]
    if turns:
        picture = np.asarray(cv2.rotate(picture, _ROTATE[turns]), dtype=np.uint8)
    return picture[:, ::-1] if mirrored else picture
