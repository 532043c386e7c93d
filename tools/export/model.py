"""What an exporter is given (shots with their targets) and what it gives back (files). Frozen values.

Pixels here are those of the *exported* picture: integer = pixel centre, so it covers [-0.5, width - 0.5].
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from common.geometry import Box, CameraModel, Pose
from common.labels import Label, ObjectLabel, Window
from tools.export.pictures import Change

Array = NDArray[np.float64]
SplitName = Literal["train", "val", "test"]
SPLITS: tuple[SplitName, ...] = ("train", "val", "test")


@dataclass(frozen=True, eq=False)
class Source:
    """A sample as it lies in its session: ``folder`` is the session's, ``boxes`` the rig's objects by name."""

    folder: Path
    label: Label
    boxes: Mapping[str, Box]

    @cached_property
    def poses(self) -> dict[str, Pose]:
        """Object to camera frame, by the object's name."""
        return {item.name: Pose.from_label(item.pose) for item in self.label.objects}

    @cached_property
    def picture(self) -> Path:
        """The stored picture."""
        assert self.label.files is not None
        return self.folder / self.label.files.rgb.path


@dataclass(frozen=True, eq=False)
class Target:
    """What a detector is to find: an object, or one of its sides.

    ``corners`` (8, 2) of the whole object, NaN behind the camera; ``states`` (8,): 0 outside the picture, 1 hidden,
    2 visible; ``outline`` (N, 2), convex, clipped to the picture; ``window`` likewise, around the whole target
    (``window_unclipped`` reaches outside). ``pose``: object to camera frame.
    """

    class_id: int
    class_name: str
    item: ObjectLabel
    box: Box
    pose: Pose
    corners: Array
    states: tuple[int, ...]
    outline: Array
    window: Window
    window_unclipped: Window
    is_side: bool = False


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture of the export: ``stem`` is its name without extension, unique in the export."""

    number: int
    stem: str
    split: SplitName
    source: Source
    camera: CameraModel
    change: Change
    targets: tuple[Target, ...]

    @property
    def key(self) -> str:
        """Names what picture this is: the same key, the same pixels."""
        assert self.source.label.files is not None
        return f"{self.source.label.files.rgb.sha256}:{self.change.key}"


@dataclass(frozen=True, eq=False)
class Export:
    """A whole export as it is planned."""

    name: str
    classes: tuple[str, ...]
    shots: tuple[Shot, ...]
    stated: Mapping[str, Any] = field(default_factory=dict)

    def of(self, split: SplitName) -> list[Shot]:
        """The shots of a part."""
        return [shot for shot in self.shots if shot.split == split]

    @property
    def splits(self) -> tuple[SplitName, ...]:
        """The parts that have a shot."""
        return tuple(split for split in SPLITS if any(shot.split == split for shot in self.shots))


@dataclass(frozen=True, eq=False)
class OutFile:
    """A file to be written: its bytes, or a file to link, or how to make it.

    ``path`` is relative to the export; ``key`` names the content: a file whose key is known to be there is kept.
    ``size`` is what it will take on the disk (a guess where it is made; 0 where it is linked).
    """

    path: PurePosixPath
    key: str
    data: bytes | None = None
    link: Path | None = None
    make: Callable[[], bytes] | None = None
    size: int = 0


@dataclass(frozen=True)
class Written:
    """What an exporter gives for one shot: its files, and what the index needs to know of it."""

    files: tuple[OutFile, ...]
    told: Any = None


@dataclass(frozen=True, eq=False)
class ReadTarget:
    """A target as it was read from an exported file alone; what the format doesn't store is None.

    ``window`` (4,) x_min y_min x_max y_max, ``points`` (8, 2) the corners in tagmill's order (NaN: not stored).
    """

    class_name: str
    window: Array | None = None
    points: Array | None = None
    outline: Array | None = None


@dataclass(frozen=True)
class Traits:
    """What a format is like.

    ``whole``: it describes whole objects, so no class can be a side; ``undistorted``: it has no place for lens
    distortion; ``rounding_px``: what its numbers' rounding may move a point by; ``pictures``: allowed formats.
    ``lossy``: it can't hold the whole pose, so its reprojection is told instead of held against a limit.
    """

    default_classes: Literal["side", "type"] = "side"
    whole: bool = False
    undistorted: bool = False
    rounding_px: float = 0.01
    pictures: tuple[str, ...] = ("png", "jpg")
    lossy: bool = False


class Exporter(Protocol):
    """A format. The constructor takes nothing; all methods may be called from several threads."""

    traits: Traits

    def shot(self, shot: Shot, export: Export) -> Written:
        """The files of one shot: its picture, and what belongs to it alone."""
        ...

    def index(self, export: Export, told: Sequence[Any]) -> list[OutFile]:
        """The files that make it a training set; written last. ``told``: each shot's ``Written.told``."""
        ...

    def read(self, folder: Path, export: Export) -> Iterator[tuple[Shot, list[ReadTarget]]]:
        """Each shot's targets, from the exported files alone; raises DatasetError for a file that is wrong."""
        ...

    def notes(self, export: Export) -> list[str]:
        """What this format can't hold, or asks for, in sentences."""
        ...


def text_file(path: str, text: str) -> OutFile:
    """A small text file."""
    import hashlib

    data = text.encode()
    return OutFile(PurePosixPath(path), hashlib.sha256(data).hexdigest(), data=data, size=len(data))
