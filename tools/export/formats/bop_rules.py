"""BOP's rules, looked at without its toolkit: what bop_toolkit and its users take for granted of a folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from common.errors import DatasetError
from tools.export.formats.parts import read_json, read_text

_ROTATION_TOLERANCE = 1e-6


def check_bop(folder: Path, parts: Sequence[str]) -> str:
    """Every scene and model; raises DatasetError naming the first rule that is broken."""
    problem = next(_problems(folder, parts), None)
    if problem is not None:
        raise DatasetError(f"against BOP's rules: {problem}")
    scenes = len(_scenes(folder, parts))
    return f"BOP's rules (own check): {scenes} scenes, masks, counts, depth, models"


def _scenes(folder: Path, parts: Sequence[str]) -> list[Path]:
    return sorted(path.parent for part in parts for path in (folder / part).glob("*/scene_gt.json"))


def _problems(folder: Path, parts: Sequence[str]) -> Iterator[str]:
    camera, models = read_json(folder / "camera.json"), read_json(folder / "models" / "models_info.json")
    missing = {"cx", "cy", "fx", "fy", "depth_scale", "width", "height"} - camera.keys()
    if missing:
        yield f"camera.json lacks {sorted(missing)}"
    yield from _model_problems(folder, models)
    scenes = _scenes(folder, parts)
    if not scenes:
        yield "there is no scene"
    for scene in scenes:
        yield from _scene_problems(scene, models)


def _model_problems(folder: Path, models: dict[str, Any]) -> Iterator[str]:
    for number, model in models.items():
        lines = read_text(folder / "models" / f"obj_{int(number):06d}.ply").splitlines()
        count = int(next(line for line in lines if line.startswith("element vertex")).split()[2])
        begin = lines.index("end_header") + 1
        rows = np.array([line.split() for line in lines[begin : begin + count]], dtype=np.float64)
        low, size = rows[:, :3].min(axis=0), np.ptp(rows[:, :3], axis=0)
        if not np.allclose(low + size / 2, 0.0, atol=1e-3):
            yield f"model {number} is not centred"
        if not np.allclose([*low, *size], [model[f"{kind}_{axis}"] for kind in ("min", "size") for axis in "xyz"]):
            yield f"model {number} and models_info.json differ"
        if not np.isclose(model["diameter"], np.linalg.norm(size)):
            yield f"the diameter of model {number} is wrong"
        if (np.einsum("ij,ij->i", rows[:, :3], rows[:, 3:6]) <= 0).any():
            yield f"a normal of model {number} points inwards"


def _scene_problems(scene: Path, models: dict[str, Any]) -> Iterator[str]:
    cameras, truth, info = (read_json(scene / f"{name}.json") for name in ("scene_camera", "scene_gt", "scene_gt_info"))
    if not (cameras.keys() == truth.keys() == info.keys()):
        yield f"{scene}: the three JSON files name other pictures"
        return
    for image, rows in truth.items():
        where = f"{scene.parent.name}/{scene.name}, picture {image}"
        pictures = list((scene / "rgb").glob(f"{int(image):06d}.*"))
        if len(pictures) != 1:
            yield f"{where} has {len(pictures)} files in rgb"
            continue
        if len(cameras[image]["cam_K"]) != 9 or len(rows) != len(info[image]):
            yield f"{where}: cam_K has not 9 numbers, or scene_gt_info has other rows than scene_gt"
            continue
        depth_file = scene / "depth" / f"{int(image):06d}.png"
        depth = cv2.imread(str(depth_file), cv2.IMREAD_UNCHANGED) if depth_file.exists() else None
        if depth is not None and (depth.ndim != 2 or depth.dtype != np.uint16):
            yield f"{where}: depth is not 16 bit"
        for number, (row, about) in enumerate(zip(rows, info[image], strict=True)):
            yield from _object_problems(scene, int(image), number, row, about, models, depth, where)


def _object_problems(
    scene: Path,
    image: int,
    number: int,
    row: dict[str, Any],
    about: dict[str, Any],
    models: dict[str, Any],
    depth: Any,
    where: str,
) -> Iterator[str]:
    where = f"{where}, object {number}"
    rotation = np.array(row["cam_R_m2c"]).reshape(3, 3)
    if str(row["obj_id"]) not in models:
        yield f"{where} has no model"
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=_ROTATION_TOLERANCE) or np.linalg.det(rotation) < 0:
        yield f"{where}: cam_R_m2c is no rotation"
    masks = [_mask(scene / kind / f"{image:06d}_{number:06d}.png") for kind in ("mask", "mask_visib")]
    whole, visible = masks
    if whole is None or visible is None:
        yield f"{where} lacks a mask, or it has other values than 0 and 255"
        return
    if (visible & ~whole).any():
        yield f"{where}: more is visible than there is"
    seen = int(visible.sum())
    if about["px_count_visib"] != seen or about["px_count_all"] < int(whole.sum()):
        yield f"{where}: px_count differs from the masks"
    if depth is not None and about["px_count_valid"] != int((whole & (depth > 0)).sum()):
        yield f"{where}: px_count_valid differs from the depth picture"
    if abs(about["visib_fract"] - seen / max(about["px_count_all"], 1)) > 1e-6:
        yield f"{where}: visib_fract is wrong"
    if seen:
        rows, columns = np.nonzero(visible)
        box = [columns.min(), rows.min(), np.ptp(columns), np.ptp(rows)]
        if about["bbox_visib"] != [int(value) for value in box]:
            yield f"{where}: bbox_visib is {about['bbox_visib']} instead of {[int(value) for value in box]}"
    elif about["bbox_visib"] != [-1, -1, -1, -1]:
        yield f"{where}: bbox_visib of an invisible object is not -1"


def _mask(path: Path) -> Any:
    """A mask as bool (H, W); None if it isn't there or isn't one."""
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if picture is None or picture.ndim != 2 or not set(np.unique(picture)) <= {0, 255}:
        return None
    return picture == 255
