"""Faults as they happen to a dataset, planted into a session: each label and picture still opens and has its checksum.

Each takes a session and a sample and writes the changed sample whole, as a tool that went wrong would have.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from common.dataset import SessionReader, label_path
from common.geometry import CameraModel, Pose
from common.labels import Label, ObjectLabel, Window
from services.label.windows import project_box, side_polygon
from tests.support.rendered_session import BOXES

Fault = Callable[[SessionReader, str], None]


def moved(by_mm: tuple[float, float, float], turn_deg: float = 0.0) -> Fault:
    """The pose of the first object, and everything that follows from it, is elsewhere; corners of markers too."""

    def fault(reader: SessionReader, sample: str) -> None:
        label = reader.label(sample)
        turn = Pose.from_rvec(np.radians([0.0, turn_deg, 0.0]), np.zeros(3)).rotation
        pose = Pose.from_label(label.objects[0].pose)
        there = Pose(turn @ pose.rotation, pose.translation + np.array(by_mm))
        write(reader, with_first(label, posed(label.objects[0], there, label)))

    return fault


def posed(item: ObjectLabel, pose: Pose, label: Label) -> ObjectLabel:
    """An object's label as it would be for another pose."""
    camera, box = CameraModel.from_label(label.camera), next(box for box in BOXES if box.name == item.name)
    projected = project_box(box, pose, camera)
    places = {marker.id: (side, marker) for side, marker in box.markers()}

    def corners(marker: int) -> object:
        side, placed = places[marker]
        return tuple(map(tuple, camera.project(pose.apply(box.marker_corners(side, placed)))[0].tolist()))

    sides = tuple(
        side.model_copy(
            update={
                "polygon": side_polygon(box, side.face, pose, camera),
                "marker_corners": corners(side.marker),
            }
        )
        for side in item.sides
    )
    return item.model_copy(
        update={
            "pose": pose.label(),
            "corners": projected.corners,
            "window": projected.window,
            "window_unclipped": projected.window_unclipped,
            "distance_mm": float(np.linalg.norm(pose.translation)),
            "sides": sides,
        }
    )


def with_first(label: Label, item: ObjectLabel) -> Label:
    return label.model_copy(update={"objects": (item, *label.objects[1:])})


def large_residual(reader: SessionReader, sample: str) -> None:
    label = reader.label(sample)
    quality = label.objects[0].quality.model_copy(update={"reprojection_error_px": 4.0})
    write(reader, with_first(label, label.objects[0].model_copy(update={"quality": quality})))


def window_only(reader: SessionReader, sample: str) -> None:
    """Window and pose no longer agree."""
    label = reader.label(sample)
    old = label.objects[0].window_unclipped
    new = Window(x_min=old.x_min - 14, y_min=old.y_min, x_max=old.x_max - 14, y_max=old.y_max)
    write(reader, with_first(label, label.objects[0].model_copy(update={"window": new, "window_unclipped": new})))


def other_side(reader: SessionReader, sample: str) -> None:
    """The class of a side is another's."""
    label = reader.label(sample)
    first, *rest = label.objects[0].sides
    named = first.model_copy(update={"class_name": "back" if first.class_name != "back" else "front"})
    write(reader, with_first(label, label.objects[0].model_copy(update={"sides": (named, *rest)})))


def object_gone(reader: SessionReader, sample: str) -> None:
    label = reader.label(sample)
    write(reader, label.model_copy(update={"objects": label.objects[1:]}))


def marker_left(share: float = 1.0, blurred: float = 0.0) -> Fault:
    """A marker is still in the picture, or the upper part of it, or it is too blurred to be decoded."""

    def fault(reader: SessionReader, sample: str) -> None:
        label = reader.label(sample)
        side = max((side for item in label.objects for side in item.sides), key=lambda one: one.polygon and _area(one))
        from tests.support.rendered_session import FAMILY

        cells = FAMILY.bitmap(side.marker) * 170 + 30
        wide = np.pad(cells, 1, constant_values=200).astype(np.uint8)
        wide[int(np.ceil(len(wide) * share)) :] = 0
        big = cv2.resize(wide, None, fx=12, fy=12, interpolation=cv2.INTER_NEAREST)
        unit = np.array(
            [[12, 12], [big.shape[1] - 12, 12], [big.shape[1] - 12, big.shape[0] - 12], [12, big.shape[0] - 12]]
        )
        to = cv2.getPerspectiveTransform(
            (unit - 0.5).astype(np.float32), np.array(side.marker_corners, dtype=np.float32)
        )
        bgr = reader.colour(label)
        size = (bgr.shape[1], bgr.shape[0])
        drawn = cv2.warpPerspective(big, to, size, flags=cv2.INTER_LINEAR)
        if blurred:
            drawn = cv2.GaussianBlur(drawn, (0, 0), blurred)
        shown = np.zeros_like(big)
        shown[: int(len(big) * share)] = 255
        mask = cv2.warpPerspective(shown, to, size) > 127
        bgr[mask] = drawn[mask][:, None]
        write(reader, label, bgr)

    return fault


def _area(side: object) -> float:
    return abs(float(cv2.contourArea(np.array(side.marker_corners, dtype=np.float32))))  # type: ignore[attr-defined]


def picture_of(steps: int) -> Fault:
    """The picture is that of another sample, so many further on."""

    def fault(reader: SessionReader, sample: str) -> None:
        names = reader.samples()
        other = names[(names.index(sample) + steps) % len(names)]
        # not byte for byte the other's: written anew with a grain of its own
        bgr = reader.colour(other)
        bgr[0, 0] ^= 1
        write(reader, reader.label(sample), bgr)

    return fault


def same_picture(reader: SessionReader, sample: str) -> None:
    """The camera stood still: byte for byte the picture before."""
    names = reader.samples()
    write(reader, reader.label(sample), reader.colour(names[names.index(sample) - 1]))


def depth_of(steps: int) -> Fault:
    """The depth picture is that of another sample."""

    def fault(reader: SessionReader, sample: str) -> None:
        names = reader.samples()
        other = reader.depth(names[(names.index(sample) + steps) % len(names)])
        write(reader, reader.label(sample), depth=other)

    return fault


def depth_scaled(reader: SessionReader, sample: str) -> None:
    depth = reader.depth(sample)
    assert depth is not None
    write(reader, reader.label(sample), depth=(depth * 1.1).astype(np.uint16))


def blurred(reader: SessionReader, sample: str) -> None:
    write(reader, reader.label(sample), cv2.blur(reader.colour(sample), (15, 1)))


def dark(reader: SessionReader, sample: str) -> None:
    write(reader, reader.label(sample), (reader.colour(sample) * 0.08).astype(np.uint8))


def write(
    reader: SessionReader,
    label: Label,
    bgr: NDArray[np.uint8] | None = None,
    depth: NDArray[np.uint16] | None = None,
) -> None:
    """Write a changed sample, with the right sizes and checksums."""
    assert label.files is not None
    files = label.files
    for kind, picture in (("rgb", bgr), ("depth", depth)):
        if picture is not None:
            file = getattr(files, kind)
            data = cv2.imencode(".png", picture)[1].tobytes()
            _replace(reader.folder / file.path, data)
            new = file.model_copy(update={"size": len(data), "sha256": hashlib.sha256(data).hexdigest()})
            files = files.model_copy(update={kind: new})
    label = label.model_copy(update={"files": files})
    _replace(reader.folder / label_path(label.sample), label.model_dump_json(by_alias=True, indent=1).encode())


def _replace(path: Path, data: bytes) -> None:
    path.unlink()
    path.write_bytes(data)


FAULTS: tuple[tuple[str, Fault], ...] = (
    ("moved aside", moved((25.0, 0.0, 0.0))),
    ("marker left", marker_left()),
    ("large residual", large_residual),
    ("other depth", depth_of(37)),
    ("other picture", picture_of(41)),
    ("window only", window_only),
    ("other side", other_side),
    ("object gone", object_gone),
    ("further away", moved((0.0, 0.0, 45.0))),
    ("turned", moved((0.0, 0.0, 0.0), turn_deg=14.0)),
    ("half a marker left", marker_left(share=0.6)),
    ("blurred marker left", marker_left(blurred=2.5)),
    ("same picture", same_picture),
    ("blurred", blurred),
    ("dark", dark),
    ("depth scaled", depth_scaled),
    ("picture some steps off", picture_of(9)),
    ("moved up", moved((0.0, -20.0, 0.0))),
    ("depth some steps off", depth_of(12)),
    ("turned back", moved((10.0, 0.0, 0.0), turn_deg=-10.0)),
)


def plant(folder: Path, at: Sequence[int], faults: Sequence[tuple[str, Fault]] = FAULTS) -> dict[str, str]:
    """Plant a fault at each of these samples; returns what was planted by sample."""
    reader = SessionReader(folder)
    names = reader.samples()
    planted = {}
    for index, (name, fault) in zip(at, faults, strict=True):
        fault(reader, names[index])
        planted[names[index]] = name
    return planted
