"""BOP, scenewise: undistorted pictures, depth, masks, poses, cuboid models (github.com/thodan/bop_toolkit).

A scene is what one camera saw in one session. Poses are model to camera in mm; the model frame is tagmill's object
frame (origin at the box's centre, Z up). ``tagmill-objects.json`` names the object ids.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar, NamedTuple

import numpy as np

from common.geometry import Box, Pose
from tools.export.formats.bop_coco import SceneCoco
from tools.export.formats.parts import Array, json_text, picture_file, read_json
from tools.export.masks import runs
from tools.export.model import Export, OutFile, ReadTarget, Shot, Target, Traits, Written, text_file
from tools.export.pictures import png
from tools.export.solid import diameter, ply, solid_of

DELTA_MM = 15.0
DELTA_SHARE = 0.01
"""What measured depth may lie before the model without hiding it: BOP's 15 mm, or a sensor's 1 % of the distance."""
OBJECTS = "tagmill-objects.json"


class Place(NamedTuple):
    """Where a shot is: its scene's folder and its number there."""

    scene: str
    image: int


class Bop:
    """BOP's scenewise format."""

    traits: ClassVar[Traits] = Traits(default_classes="type", whole=True, undistorted=True)

    def shot(self, shot: Shot, export: Export) -> Written:
        """Picture, depth, and two masks an object."""
        scene, image = _places(export)[shot.stem]
        files = [picture_file(shot, f"{scene}/rgb/{image:06d}.{shot.change.extension}")]
        measured, unit = None, 1.0
        if shot.source.label.depth is not None:
            unit = shot.source.label.depth.unit_mm
            depth = _depth_file(shot, f"{scene}/depth/{image:06d}.png")
            files.append(depth.file)
            measured = depth.values * unit if shot.targets else None
        info, masks = _visibility(shot, measured)
        for number, (whole, visible) in enumerate(masks):
            for kind, mask in (("mask", whole), ("mask_visib", visible)):
                data = png(np.where(mask, np.uint8(255), np.uint8(0)))
                key = f"{shot.key}:{kind}:{number}:{hash_of(data)}"
                path = PurePosixPath(f"{scene}/{kind}/{image:06d}_{number:06d}.png")
                files.append(OutFile(path, key, data=data, size=len(data)))
        camera = {"cam_K": [float(value) for value in shot.camera.matrix.ravel()], "depth_scale": unit}
        return Written(tuple(files), {"camera": camera, "info": info, "runs": [runs(seen) for _, seen in masks]})

    def index(self, export: Export, told: Sequence[Any]) -> list[OutFile]:
        """Each scene's JSON files, the models, the camera."""
        ids, places = object_ids(export), _places(export)
        scenes: dict[str, dict[str, dict[str, Any]]] = {}
        coco: dict[str, SceneCoco] = {}
        names = {number: name for name, _, number in _objects(export)}
        for shot in export.shots:
            scene, image = places[shot.stem]
            rows = scenes.setdefault(scene, {"scene_camera": {}, "scene_gt": {}, "scene_gt_info": {}})
            rows["scene_camera"][str(image)] = told[shot.number]["camera"]
            rows["scene_gt"][str(image)] = [_truth(target, ids) for target in shot.targets]
            rows["scene_gt_info"][str(image)] = told[shot.number]["info"]
            coco.setdefault(scene, SceneCoco(names)).add(
                image,
                f"rgb/{image:06d}.{shot.change.extension}",
                (shot.camera.width, shot.camera.height),
                [row["obj_id"] for row in rows["scene_gt"][str(image)]],
                told[shot.number]["info"],
                told[shot.number]["runs"],
            )
        files = [
            text_file(f"{scene}/{name}.json", json_text(plain))
            for scene, rows in scenes.items()
            for name, plain in rows.items()
        ]
        files += [text_file(f"{scene}/scene_gt_coco.json", json_text(one.plain())) for scene, one in coco.items()]
        first = export.shots[0]
        k = first.camera.matrix
        camera = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
        camera |= {"depth_scale": told[0]["camera"]["depth_scale"]}
        sizes = {"width": first.camera.width, "height": first.camera.height}
        boxes = {number: (name, box) for name, box, number in _objects(export)}
        models = {str(number): _model(box) for number, (_, box) in boxes.items()}
        named = {str(number): {"class": name, "size_mm": list(box.size_mm)} for number, (name, box) in boxes.items()}
        files += [text_file(f"models/obj_{number:06d}.ply", ply(box)) for number, (_, box) in boxes.items()]
        files += [
            text_file("models/models_info.json", json_text(models)),
            text_file(OBJECTS, json_text(named)),
            text_file("camera.json", json_text({key: float(value) for key, value in camera.items()} | sizes)),
        ]
        if "test" in export.splits:
            files.append(text_file("test_targets_bop19.json", json_text(_test_targets(export, ids, places))))
        return files

    def read(self, folder: Path, export: Export) -> Iterator[tuple[Shot, list[ReadTarget]]]:
        """From the scenes' JSON files and the models: the models' corners, projected."""
        names, models = read_json(folder / OBJECTS), read_json(folder / "models" / "models_info.json")
        places = _places(export)
        scenes: dict[str, tuple[Any, Any]] = {}
        for shot in export.shots:
            scene, image = places[shot.stem]
            if scene not in scenes:
                parts = [read_json(folder / scene / f"{name}.json") for name in ("scene_camera", "scene_gt")]
                scenes[scene] = parts[0], parts[1]
            cameras, truth = scenes[scene]
            matrix = np.array(cameras[str(image)]["cam_K"]).reshape(3, 3)
            found = []
            for row in truth[str(image)]:
                corners = corners_of(models[str(row["obj_id"])])
                xyz = corners @ np.array(row["cam_R_m2c"]).reshape(3, 3).T + np.array(row["cam_t_m2c"])
                pixels = xyz @ matrix.T
                found.append(ReadTarget(names[str(row["obj_id"])]["class"], points=pixels[:, :2] / pixels[:, 2:]))
            yield shot, found

    def notes(self, export: Export) -> list[str]:
        """What is missing without a depth camera, and where cameras differ."""
        notes = []
        if any(shot.source.label.depth is None for shot in export.shots):
            notes.append("samples without depth get no depth picture; their visibility is by geometry alone")
        if len({shot.camera.matrix.tobytes() for shot in export.shots}) > 1:
            notes.append("camera.json has the first camera's intrinsics; each picture's own are in scene_camera.json")
        return notes


class _Depth(NamedTuple):
    file: OutFile
    values: Array


def _depth_file(shot: Shot, path: str) -> _Depth:
    files = shot.source.label.files
    assert files is not None
    assert files.depth is not None
    stored = shot.source.folder / files.depth.path
    values = shot.change.depth(stored)
    plain = shot.change
    if not plain.undistort and plain.size == (plain.camera.width, plain.camera.height):
        file = OutFile(PurePosixPath(path), files.depth.sha256, link=stored, size=files.depth.size)
    else:
        key = f"{files.depth.sha256}:{plain.key}"
        file = OutFile(PurePosixPath(path), key, make=lambda: png(plain.depth(stored)), size=files.depth.size)
    return _Depth(file, values.astype(np.float64))


def _visibility(shot: Shot, measured: Array | None) -> tuple[list[dict[str, Any]], list[tuple[Any, Any]]]:
    """BOP's ``scene_gt_info`` rows, and for each target its mask and the visible part of it (H, W)."""
    width, height = shot.camera.width, shot.camera.height
    solids = [solid_of(target, shot) for target in shot.targets]
    depths = [solid.in_picture(width, height) for solid in solids]
    nearest = np.minimum.reduce(depths) if depths else None
    info, masks = [], []
    for solid, depth in zip(solids, depths, strict=True):
        whole = np.isfinite(depth)
        assert nearest is not None
        visible = whole & (depth <= nearest + 1e-6)
        valid = 0
        if measured is not None:
            limit = np.maximum(DELTA_MM, DELTA_SHARE * np.where(whole, depth, 0.0))
            visible &= (measured == 0) | (measured >= depth - limit)
            valid = int((whole & (measured > 0)).sum())
        everything = np.isfinite(solid.depth)
        count, seen = int(everything.sum()), int(visible.sum())
        info.append(
            {
                "bbox_obj": _bounds(everything, solid.left, solid.top) if seen else [-1, -1, -1, -1],
                "bbox_visib": _bounds(visible, 0, 0) if seen else [-1, -1, -1, -1],
                "px_count_all": count,
                "px_count_valid": valid,
                "px_count_visib": seen,
                "visib_fract": seen / count if count else 0.0,
            }
        )
        masks.append((whole, visible))
    return info, masks


def _bounds(mask: Any, left: int, top: int) -> list[int]:
    """x, y, width, height as bop_toolkit counts them: width is the last column minus the first."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = [columns[0] + left, rows[0] + top, columns[-1] - columns[0], rows[-1] - rows[0]]
    return [int(value) for value in box]


def _truth(target: Target, ids: dict[tuple[str, tuple[float, ...]], int]) -> dict[str, Any]:
    pose: Pose = target.pose
    return {
        "obj_id": ids[target.class_name, target.box.size_mm],
        "cam_R_m2c": [float(value) for value in pose.rotation.ravel()],
        "cam_t_m2c": [float(value) for value in pose.translation],
    }


def _test_targets(
    export: Export, ids: dict[tuple[str, tuple[float, ...]], int], places: dict[str, Place]
) -> list[dict[str, int]]:
    rows = []
    for shot in export.of("test"):
        found = [ids[target.class_name, target.box.size_mm] for target in shot.targets]
        scene, image = places[shot.stem]
        number = int(scene.rpartition("/")[2])
        rows += [
            {"scene_id": number, "im_id": image, "obj_id": one, "inst_count": found.count(one)}
            for one in sorted(set(found))
        ]
    return rows


def object_ids(export: Export) -> dict[tuple[str, tuple[float, ...]], int]:
    """An id for each class and size: boxes of one class may differ in size, and then are other models."""
    found: dict[tuple[str, tuple[float, ...]], int] = {}
    for name in export.classes:
        for shot in export.shots:
            for target in shot.targets:
                if target.class_name == name:
                    found.setdefault((name, target.box.size_mm), len(found) + 1)
    return found


def _objects(export: Export) -> list[tuple[str, Box, int]]:
    ids = object_ids(export)
    boxes: dict[int, tuple[str, Box]] = {}
    for shot in export.shots:
        for target in shot.targets:
            boxes.setdefault(ids[target.class_name, target.box.size_mm], (target.class_name, target.box))
    return [(name, box, number) for number, (name, box) in sorted(boxes.items())]


def _model(box: Box) -> dict[str, float]:
    low, size = box.corners.min(axis=0), np.ptp(box.corners, axis=0)
    plain = {"diameter": diameter(box)}
    plain |= {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    return plain | {f"size_{axis}": float(value) for axis, value in zip("xyz", size, strict=True)}


def corners_of(model: dict[str, float]) -> Array:
    """The corners (8, 3) of a row of ``models_info.json``, in tagmill's order."""
    size = [model[f"size_{axis}"] for axis in "xyz"]
    low = np.array([model[f"min_{axis}"] for axis in "xyz"])
    unit = Box("", "", (1.0, 1.0, 1.0), ()).corners + 0.5
    return np.asarray(low + unit * np.array(size))


def hash_of(data: bytes) -> str:
    """Short name of a content."""
    import hashlib

    return hashlib.sha256(data).hexdigest()[:16]


@lru_cache(maxsize=2)
def _places(export: Export) -> dict[str, Place]:
    """Scenes are numbered from 1 on over all parts, pictures from 0 on in each."""
    numbers: dict[tuple[str, str, str], int] = {}
    counts: dict[str, int] = {}
    found: dict[str, Place] = {}
    for part in export.splits:
        for shot in export.of(part):
            key = (part, str(shot.source.folder), shot.source.label.camera.name)
            scene = f"{part}/{numbers.setdefault(key, len(numbers) + 1):06d}"
            found[shot.stem] = Place(scene, counts.get(scene, 0))
            counts[scene] = counts.get(scene, 0) + 1
    return found
