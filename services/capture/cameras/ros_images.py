"""Messages of ROS made into pictures and intrinsics; pure, the same for ROS 1 and 2 (``rosbags`` names them alike)."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import CameraModel
from common.pictures import decode
from services.capture.cameras.base import FrameSkippedError
from services.capture.cameras.pictures import Colour, Depth

RAW, COMPRESSED, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"

# Encoding: (type, channels, cv2's conversion to BGR or None). ROS names a Bayer pattern by its first two pixels, cv2
# by those of the second row.
_ENCODINGS: dict[str, tuple[str, int, int | None]] = {
    "bgr8": ("u1", 3, None),
    "8UC3": ("u1", 3, None),
    "rgb8": ("u1", 3, cv2.COLOR_RGB2BGR),
    "bgra8": ("u1", 4, cv2.COLOR_BGRA2BGR),
    "8UC4": ("u1", 4, cv2.COLOR_BGRA2BGR),
    "rgba8": ("u1", 4, cv2.COLOR_RGBA2BGR),
    "mono8": ("u1", 1, cv2.COLOR_GRAY2BGR),
    "8UC1": ("u1", 1, cv2.COLOR_GRAY2BGR),
    "mono16": ("u2", 1, cv2.COLOR_GRAY2BGR),
    "16UC1": ("u2", 1, cv2.COLOR_GRAY2BGR),
    "bayer_rggb8": ("u1", 1, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": ("u1", 1, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": ("u1", 1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": ("u1", 1, cv2.COLOR_BayerGB2BGR),
    "yuv422": ("u1", 2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": ("u1", 2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": ("u1", 2, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": ("u1", 2, cv2.COLOR_YUV2BGR_YUY2),
}
_DEPTH_HEADER = 12
"""Of ``compressedDepth``: twelve bytes of its own before the PNG."""


def colour_of(kind: str, message: Any, name: str) -> Colour:
    """An image message of type ``kind`` as (H, W, 3) uint8 BGR; raises FrameSkippedError, naming ``name``."""
    if kind == COMPRESSED:
        picture = _decoded(np.asarray(message.data), cv2.IMREAD_COLOR, name)
        # Its pixels may have been RGB before they were compressed; the format then says so.
        swapped = "rgb8; jpeg compressed rgb8" in str(message.format)
        return np.ascontiguousarray(picture[..., ::-1] if swapped else picture, dtype=np.uint8)
    kind_of_pixel, channels, conversion = _encoding(message, name)
    pixels = _pixels(message, kind_of_pixel, channels, name)
    if pixels.dtype.itemsize == 2:
        pixels = np.asarray(cv2.convertScaleAbs(pixels, alpha=255 / 65535))
    if conversion is not None:
        try:
            pixels = np.asarray(cv2.cvtColor(pixels, conversion))
        except cv2.error as error:  # two pixels share a colour in YUV 4:2:2, so an odd width can't be
            size = f"{pixels.shape[1]}x{pixels.shape[0]}"
            raise FrameSkippedError(f"{name} can't be {message.encoding} with {size} pixels", "unreadable") from error
    return np.ascontiguousarray(pixels, dtype=np.uint8)


def depth_of(kind: str, message: Any, unit_mm: float, name: str) -> Depth:
    """A depth message as (H, W) uint16: ``16UC1`` as it is, ``32FC1`` (m) in steps of ``unit_mm``; 0 = invalid."""
    if kind == COMPRESSED:
        data = np.asarray(message.data)
        picture = _decoded(
            data[_DEPTH_HEADER * ("compressedDepth" in str(message.format)) :], cv2.IMREAD_UNCHANGED, name
        )
        if picture.dtype != np.uint16 or picture.ndim != 2:
            raise FrameSkippedError(f"{name} is no depth picture of 16 bits", "unreadable")
        return np.ascontiguousarray(picture, dtype=np.uint16)
    if message.encoding in {"16UC1", "mono16"}:
        return np.ascontiguousarray(_pixels(message, "u2", 1, name), dtype=np.uint16)
    if message.encoding == "32FC1":
        steps = _pixels(message, "f4", 1, name).astype(np.float64) * (1000 / unit_mm)
        known = np.isfinite(steps) & (steps > 0) & (steps < np.iinfo(np.uint16).max)
        return np.where(known, np.rint(np.where(known, steps, 0)), 0).astype(np.uint16)
    raise FrameSkippedError(f"{name} has the encoding {message.encoding}; depth is 16UC1 or 32FC1", "unreadable")


def camera_of(info: Any, *, rectified: bool) -> CameraModel | None:
    """The intrinsics of a camera_info message; None for an uncalibrated camera or a lens model that cv2 lacks.

    ``rectified``: for pictures that are already undistorted, to which its matrix P belongs.
    """
    intrinsic, distortion = _either(info, "k"), np.asarray(_either(info, "d"), dtype=np.float64).ravel()
    matrix = np.asarray(_either(info, "p"), np.float64).reshape(3, 4)[:, :3] if rectified else intrinsic
    matrix = np.asarray(matrix, dtype=np.float64).reshape(3, 3)
    if matrix[0, 0] <= 0 or not info.width or not info.height:
        return None
    size = (int(info.width), int(info.height))
    if rectified or not distortion.any():
        return CameraModel(*size, matrix, np.zeros(5))
    if info.distortion_model in {"equidistant", "fisheye", "kannala_brandt4"} and len(distortion) >= 4:
        return CameraModel(*size, matrix, distortion[:4], model="fisheye")
    if len(distortion) in {4, 5, 8, 12, 14} and info.distortion_model in {"plumb_bob", "rational_polynomial", ""}:
        return CameraModel(*size, matrix, distortion)
    return None


def stamp_ns(message: Any, otherwise_ns: int) -> int:
    """When the message's picture was taken; ``otherwise_ns`` (when it was recorded) if it doesn't say."""
    stamp = message.header.stamp
    return (int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)) or otherwise_ns


def _either(info: Any, name: str) -> Any:
    """ROS 1 writes the fields of camera_info in capitals."""
    return getattr(info, name.upper()) if hasattr(info, name.upper()) else getattr(info, name)


def _encoding(message: Any, name: str) -> tuple[str, int, int | None]:
    found = _ENCODINGS.get(message.encoding)
    if found is None:
        known = ", ".join(_ENCODINGS)
        raise FrameSkippedError(f"{name} has the encoding {message.encoding}; known are {known}", "unreadable")
    return found


def _pixels(message: Any, kind: str, channels: int, name: str) -> NDArray[Any]:
    """The message's pixels (H, W) or (H, W, channels); rows may be padded."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    kind = (">" if message.is_bigendian else "<") + kind
    row = width * channels * np.dtype(kind).itemsize
    data = np.asarray(message.data, dtype=np.uint8).ravel()
    if not height or not width or step < row or data.size < step * (height - 1) + row:
        raise FrameSkippedError(f"{name} is cut off: {data.size} bytes for {width}x{height} pixels", "unreadable")
    rows = np.lib.stride_tricks.as_strided(data, (height, row), (step, 1))
    pixels = np.ascontiguousarray(rows).view(kind).astype(np.dtype(kind).newbyteorder("="))
    return pixels if channels == 1 else pixels.reshape(height, width, channels)


def _decoded(data: NDArray[np.uint8], flags: int, name: str) -> NDArray[Any]:
    picture = decode(np.ascontiguousarray(data), flags)
    if picture is None:
        raise FrameSkippedError(f"{name} can't be read: its picture is damaged", "unreadable")
    return np.asarray(picture)
