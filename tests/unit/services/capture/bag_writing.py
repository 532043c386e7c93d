"""ROS bags for the tests, written by ``rosbags`` as ROS 1 and 2 would."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

WIDTH, HEIGHT = 64, 48
KINDS = ("ros1", "sqlite3", "mcap")
START_NS = 1_700_000_000_123_456_789
PERIOD_NS = 33_333_333


class Bag:
    """Writes messages into one bag; ``path`` is what the ``files`` driver is given."""

    def __init__(self, kind: str, path: Path) -> None:
        self.ros1 = kind == "ros1"
        self.path = path.with_suffix(".bag") if self.ros1 else path
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        self.writer: Any = Writer1(self.path) if self.ros1 else Writer2(self.path, version=9, storage_plugin=plugin)
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> Bag:
        self.writer.open()
        return self

    def __exit__(self, *error: object) -> None:
        self.writer.close()

    def write(self, topic: str, message: Any, recorded_ns: int) -> None:
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.writer.write(self._connections[topic], recorded_ns, serialize(message, kind))

    def header(self, stamp_ns: int) -> Any:
        types = self.store.types
        stamp = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        more = {"seq": 0} if self.ros1 else {}
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id="camera", **more)

    def image(self, pixels: np.ndarray, encoding: str, stamp_ns: int, padding: int = 0) -> Any:
        height, width = pixels.shape[:2]
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(height, -1)
        rows = np.pad(rows, ((0, 0), (0, padding)))
        return self.store.types["sensor_msgs/msg/Image"](
            header=self.header(stamp_ns),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=0,
            step=rows.shape[1],
            data=rows.ravel(),
        )

    def compressed(self, pixels: np.ndarray, format_: str, stamp_ns: int, head: bytes = b"") -> Any:
        suffix = ".png" if "png" in format_ or "Depth" in format_ else ".jpg"
        data = head + cv2.imencode(suffix, pixels)[1].tobytes()
        return self.store.types["sensor_msgs/msg/CompressedImage"](
            header=self.header(stamp_ns), format=format_, data=np.frombuffer(data, np.uint8)
        )

    def info(
        self, stamp_ns: int, model: str = "plumb_bob", distortion: tuple[float, ...] = (0.1, -0.2, 0, 0, 0)
    ) -> Any:
        fields = {
            "k": np.array([70.0, 0, 31.5, 0, 71.0, 23.5, 0, 0, 1]),
            "d": np.array(distortion, float),
            "r": np.eye(3).ravel(),
            "p": np.array([60.0, 0, 30, 0, 0, 61, 22, 0, 0, 0, 1, 0]),
        }
        roi = self.store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        return self.store.types["sensor_msgs/msg/CameraInfo"](
            header=self.header(stamp_ns),
            height=HEIGHT,
            width=WIDTH,
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=roi,
            **{(name.upper() if self.ros1 else name): value for name, value in fields.items()},
        )


def write_rgbd(kind: str, path: Path, frames: int, *, other: bool = False) -> Path:
    """Frames of value 10, 20, ... (red), depth 1000, 2000, ... mm a little later, camera_info; returns the path."""
    opened: AbstractContextManager[Bag] = Bag(kind, path)
    with opened as bag:
        for number in range(1, frames + 1):
            stamp = START_NS + (number - 1) * PERIOD_NS
            picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
            picture[..., 0] = 10 * number
            bag.write("/cam/color/camera_info", bag.info(stamp), stamp)
            bag.write("/cam/color/image_raw", bag.image(picture, "rgb8", stamp, padding=4), stamp + 5000)
            if other:
                bag.write("/wrist/image/compressed", bag.compressed(picture, "jpeg", stamp), stamp + 6000)
            depth = np.full((HEIGHT, WIDTH), 1000 * number, np.uint16)
            depth_stamp = stamp + 4_000_000
            bag.write("/cam/aligned_depth/image_raw", bag.image(depth, "16UC1", depth_stamp), depth_stamp)
        return bag.path
