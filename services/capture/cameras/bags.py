"""ROS 1 bags, ROS 2 bags and MCAP files (extra ``bags``): an image topic, its depth, its camera_info, exact times."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from common.config.models import FilesOptions
from common.errors import CameraError, ConfigError, TagmillError
from common.geometry import CameraModel
from services.capture.cameras.base import FrameSkippedError
from services.capture.cameras.file_sources import FileFrame, Recorded
from services.capture.cameras.nearest import Nearest
from services.capture.cameras.pictures import Depth
from services.capture.cameras.ros_images import COMPRESSED, INFO, RAW, camera_of, colour_of, depth_of, stamp_ns

PAIR_NS = 20_000_000
"""Depth belongs to a picture whose stamp is at most this far: less than half a period at 24 frames/s."""
_IMAGES = (RAW, COMPRESSED)


class BagSource:
    """See Source; ``options`` name the topics. Raises CameraError, ConfigError for a topic that isn't there."""

    def __init__(self, name: str, path: Path, options: FilesOptions) -> None:
        self._name = name
        self._path = path
        self._unit_mm = options.depth_unit_mm
        self._readers: list[AnyReader] = []
        self.fps: float | None = None
        self._index, self._last_ns = 0, -1
        reader = self._open()
        try:
            self._topic = self._chosen(reader, options.topic)
            self._depth_topic = options.depth_topic and self._chosen(reader, options.depth_topic, key="depth_topic")
            info = self._info_topic(reader, options.info_topic)
            with self._reading():
                camera = None if info is None else _first_info(reader, info, rectified="rect" in self._topic)
            self.recorded = Recorded(camera, self._unit_mm if self._depth_topic else None)
            self.fps = _rate(reader, self._topic)
            self.rewind(0)
        except (CameraError, ConfigError):
            self.close()
            raise

    def read(self) -> FileFrame | None:
        """See Source."""
        with self._reading():
            taken = next(self._images, None)
        if taken is None:
            return None
        stamp, (kind, message) = taken
        name = f"{self._path.name}#{self._index}"
        self._index += 1
        if message is None:
            raise FrameSkippedError(f"{name} can't be read: its message is damaged", "unreadable")
        bgr = colour_of(kind, message, name)
        self._last_ns = max(self._last_ns + 1, stamp)
        return FileFrame(bgr, self._depth_at(stamp, bgr.shape[:2], name), self._last_ns, name)

    def rewind(self, frame: int) -> None:
        """See Source."""
        self.close()
        self._images = _messages(self._open(), self._topic)
        self._depths = Nearest(_messages(self._open(), self._depth_topic)) if self._depth_topic else None
        self._index, self._last_ns = 0, -1
        with self._reading():
            while self._index < frame and next(self._images, None) is not None:
                self._index += 1

    def close(self) -> None:
        """See Source."""
        for reader in self._readers:
            reader.close()
        self._readers = []

    def _open(self) -> AnyReader:
        """One more reader: two streams are read apart."""
        if not self._path.exists():
            raise CameraError(f"the bag {self._path} is gone")
        with self._reading():
            # Only bags older than ROS 2 Jazzy's need types that they don't bring along.
            reader = AnyReader([self._path], default_typestore=get_typestore(Stores.LATEST))
            reader.open()
        self._readers.append(reader)
        return reader

    def _depth_at(self, stamp: int, shape: tuple[int, ...], name: str) -> Depth | None:
        if self._depths is None:
            return None
        with self._reading():
            found = self._depths.at(stamp, PAIR_NS)
        if found is None:
            return None
        kind, message = found
        if message is None:
            raise FrameSkippedError(f"{name}: its message of {self._depth_topic} is damaged", "unreadable")
        depth = depth_of(kind, message, self._unit_mm, f"{name} of {self._depth_topic}")
        if depth.shape != shape:
            raise FrameSkippedError(
                f"{name}: {self._depth_topic} has {depth.shape[1]}x{depth.shape[0]} pixels, {self._topic} "
                f"{shape[1]}x{shape[0]}; depth must be aligned to the picture (aligned_depth...)",
                "depth_size",
            )
        return depth

    def _chosen(self, reader: AnyReader, wanted: str | None, key: str = "topic") -> str:
        """The image topic: the wanted one, or the only one that is no depth."""
        images = [one for one in reader.connections if one.msgtype in _IMAGES]
        names = sorted({one.topic for one in images})
        found = [name for name in names if "depth" not in name.lower()] if wanted is None else [wanted]
        if len(found) == 1 and found[0] in names:
            return found[0]
        problem = f"has no image topic {wanted}" if wanted else f"has {len(found) or 'no'} topics with colour pictures"
        there = ", ".join(f"{one.topic} ({one.msgtype.rpartition('/')[2]}, {one.msgcount})" for one in images) or "none"
        raise ConfigError(f"cameras.{self._name}.{key}: {self._path} {problem}; name one as `{key}`: {there}")

    def _info_topic(self, reader: AnyReader, wanted: str | None) -> str | None:
        """The camera_info of the image topic: the wanted one, or by ROS's names the nearest above it."""
        there = {one.topic for one in reader.connections if one.msgtype == INFO}
        if wanted is not None:
            if wanted not in there:
                listed = ", ".join(sorted(there)) or "none"
                raise ConfigError(
                    f"cameras.{self._name}.info_topic: {self._path} has no camera_info {wanted}; there is {listed}"
                )
            return wanted
        places = (parent / leaf for parent in PurePosixPath(self._topic).parents for leaf in ("", "info"))
        return next((name for place in places if (name := str(place / "camera_info")) in there), None)

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """What the library says of a damaged file, as a CameraError."""
        try:
            yield
        except TagmillError:
            raise
        except Exception as error:
            raise CameraError(f"{self._path} can't be read as a bag: {str(error) or type(error).__name__}") from error


def _messages(reader: AnyReader, topic: str) -> Iterator[tuple[int, tuple[str, Any]]]:
    """Each message of a topic with its time and type; None for one that is damaged."""
    connections = [one for one in reader.connections if one.topic == topic]
    for connection, recorded_ns, raw in reader.messages(connections=connections):
        try:
            message = reader.deserialize(raw, connection.msgtype)
        except Exception:  # noqa: BLE001 - as above; who gets None says so and counts the frame
            yield recorded_ns, (connection.msgtype, None)
            continue
        yield stamp_ns(message, recorded_ns), (connection.msgtype, message)


def _first_info(reader: AnyReader, topic: str, *, rectified: bool) -> CameraModel | None:
    first = next(_messages(reader, topic), None)
    return None if first is None or first[1][1] is None else camera_of(first[1][1], rectified=rectified)


def _rate(reader: AnyReader, topic: str) -> float | None:
    """Frames a second on average, None for fewer than two."""
    count = sum(one.msgcount for one in reader.connections if one.topic == topic)
    return (count - 1) * 1e9 / reader.duration if count > 1 and reader.duration > 0 else None
