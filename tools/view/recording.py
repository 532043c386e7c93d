"""Samples as Rerun's entities. Rerun's package is optional and is imported here only.

Each camera is a space of its own, in its own frame (x right, y down, z forward, mm): ``CAMERA/image`` is its picture
with windows and projected boxes, ``CAMERA/objects/NAME`` a box at its pose, ``CAMERA/points`` the depth. Timelines:
``captured`` (UTC) and ``sample`` (counted).
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.dataset import SessionReader
from common.errors import RefusedError
from common.geometry import Box, CameraModel
from common.geometry.box import EDGES
from common.labels import Label, ObjectLabel

_MEDIA = {".png": "image/png", ".jpg": "image/jpeg", ".webp": "image/webp"}
_COLOURS = ((255, 140, 0), (0, 170, 255), (120, 200, 60), (220, 80, 200), (250, 220, 60), (120, 120, 255))
_HALF = 0.5
"""Rerun puts (0, 0) at the first pixel's corner, tagmill at its centre."""
Array = NDArray[np.float64]


def rerun() -> Any:
    """The package; raises RefusedError ``no_rerun`` that says how to install it."""
    try:
        return importlib.import_module("rerun")
    except ImportError as error:
        raise RefusedError(
            f"Rerun isn't installed ({error}); install it with: pip install 'tagmill[view]'", code="no_rerun"
        ) from error


class Recording:
    """One session on its way to the viewer or into a file."""

    def __init__(self, module: Any, session: str, boxes: Sequence[Box], cameras: Sequence[str]) -> None:
        self._rr = module
        self._stream = module.RecordingStream("tagmill", recording_id=session)
        self._sizes = {box.name: np.array(box.size_mm) for box in boxes}
        self._colours = {box.name: _COLOURS[index % len(_COLOURS)] for index, box in enumerate(boxes)}
        self._cameras = cameras
        self._shown: dict[str, set[str]] = {}
        self._count = 0

    def show(self) -> None:
        """Open the viewer; raises RefusedError ``no_rerun`` if it doesn't start."""
        try:
            self._stream.spawn(default_blueprint=self._layout())
        except (OSError, RuntimeError) as error:
            raise RefusedError(f"Rerun's viewer doesn't start: {error}", code="no_rerun") from error

    def save(self, path: Path) -> None:
        """Write into a file; raises RefusedError ``bad_out`` if it can't be made."""
        try:
            self._stream.save(path, default_blueprint=self._layout())
        except (OSError, RuntimeError) as error:
            raise RefusedError(f"no file can be written in {path.parent}: {error}", code="bad_out") from error

    def close(self) -> None:
        """All is with the viewer, or in the file."""
        self._stream.flush()
        self._stream.disconnect()

    def add(self, reader: SessionReader, label: Label, *, points: int, original: bool) -> None:
        """One sample; ``points``: one of so many pixels each way, 0: none. Raises DatasetError."""
        rr, stream, camera = self._rr, self._stream, label.camera.name
        stream.set_time("captured", timestamp=np.datetime64(label.captured_wall_ns, "ns"))
        stream.set_time("sample", sequence=self._count)
        self._count += 1
        model = CameraModel.from_label(label.camera)
        matrix = np.array(label.camera.matrix)
        matrix[:2, 2] += _HALF
        stream.log(camera, rr.ViewCoordinates.RDF, static=True)
        stream.log(
            f"{camera}/image",
            rr.Pinhole(
                image_from_camera=matrix,
                resolution=(model.width, model.height),
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=150.0,
            ),
        )
        kept = reader.stored(label, "original") if original else None
        file = kept or reader.stored(label, "rgb")
        assert file is not None, "a label's files name its picture"
        path = reader.path(file)
        stream.log(f"{camera}/image", rr.EncodedImage(contents=path.read_bytes(), media_type=_MEDIA.get(path.suffix)))
        stream.log(f"{camera}/label", rr.TextDocument(_words(label), media_type="text/markdown"))
        self._objects(camera, label.objects)
        if points:
            self._points(reader, label, model, points)

    def _objects(self, camera: str, objects: Sequence[ObjectLabel]) -> None:
        rr, stream = self._rr, self._stream
        here = {item.name for item in objects}
        for name in self._shown.get(camera, set()) - here:
            for part in (["objects"], ["image", "windows"], ["image", "boxes"]):
                stream.log([camera, *part, name], rr.Clear(recursive=True))
        self._shown[camera] = here
        for item in objects:
            colour, name = self._colours.get(item.name, _COLOURS[0]), item.name
            pose = np.array(item.pose.matrix)
            stream.log([camera, "objects", name], rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
            size = self._sizes.get(name)
            if size is not None:
                words = f"{name}: {item.distance_mm:.0f} mm"
                stream.log(
                    [camera, "objects", name], rr.Boxes3D(half_sizes=[size / 2], colors=[colour], labels=[words])
                )
            if item.window is not None:
                low = np.array([item.window.x_min, item.window.y_min]) + _HALF
                high = np.array([item.window.x_max, item.window.y_max]) + _HALF
                stream.log(
                    [camera, "image", "windows", name],
                    rr.Boxes2D(mins=[low], sizes=[high - low], colors=[colour], labels=[name]),
                )
            strips = _edges(item)
            stream.log([camera, "image", "boxes", name], rr.LineStrips2D(strips, colors=[colour] * len(strips)))

    def _points(self, reader: SessionReader, label: Label, model: CameraModel, apart: int) -> None:
        depth = reader.depth(label)
        if depth is None or label.depth is None:
            return
        bgr = reader.colour(label)
        rows, columns = np.mgrid[0 : model.height : apart, 0 : model.width : apart].reshape(2, -1)
        z = depth[rows, columns].astype(np.float64) * label.depth.unit_mm
        rays = model.normalise(np.column_stack([columns, rows]).astype(np.float64))
        known = (z > 0) & np.isfinite(rays).all(axis=1)
        xyz = np.column_stack([rays[known] * z[known, None], z[known]])
        colours = bgr[rows[known], columns[known], ::-1]
        self._stream.log(f"{label.camera.name}/points", self._rr.Points3D(xyz, colors=colours, radii=apart * 0.6))

    def _layout(self) -> Any:
        views = self._rr.blueprint
        rows = [
            views.Horizontal(
                views.Spatial3DView(origin=camera, name=f"{camera} in 3D"),
                views.Vertical(
                    views.Spatial2DView(origin=f"{camera}/image", name=camera),
                    views.TextDocumentView(origin=f"{camera}/label", name="label"),
                    row_shares=[3, 1],
                ),
            )
            for camera in self._cameras
        ]
        return views.Blueprint(views.Tabs(*rows) if len(rows) > 1 else rows[0], collapse_panels=True)


def _edges(item: ObjectLabel) -> list[Array]:
    """The box's edges in the picture, as far as both ends lie before the camera."""
    points = np.array([(corner.x, corner.y) for corner in item.corners], dtype=np.float64) + _HALF
    return [points[[one, other]] for one, other in EDGES if np.isfinite(points[[one, other]]).all()]


def _words(label: Label) -> str:
    rows = [f"**{label.sample}**", "", "| object | distance | sides | fit | pose |", "|---|---|---|---|---|"]
    for item in label.objects:
        sides = ", ".join(dict.fromkeys(side.class_name for side in item.sides))
        quality = f"{item.quality.reprojection_error_px:.2f} px" + (", ambiguous" if item.quality.ambiguous else "")
        rows.append(f"| {item.name} | {item.distance_mm:.0f} mm | {sides} | {quality} | {item.pose_source} |")
    return "\n".join(rows)
