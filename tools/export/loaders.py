"""The trainers' own loaders, where they are installed: what they accept is what counts.

Each takes the export's folder and its plan and returns a sentence of what was found right. It raises `Absent` where
its package isn't installed, DatasetError where the loader objects.
"""

from __future__ import annotations

import contextlib
import importlib
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import DatasetError
from tools.export.formats.bop_rules import check_bop
from tools.export.model import Export

Loader = Callable[[Path, Export], str]


class Absent(Exception):  # noqa: N818 - it is no error, a package is not there
    """A loader isn't installed; the text says how to get it."""


def _import(module: str, how: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        raise Absent(f"{module.partition('.')[0]} is not installed ({how})") from None


def with_pycocotools(folder: Path, export: Export) -> str:
    """COCO: every mask decodes, and the truth evaluated against itself gives 1.0."""
    coco = _import("pycocotools.coco", "pip install 'tagmill[check]'")
    evaluation = _import("pycocotools.cocoeval", "pip install 'tagmill[check]'")
    masks = 0
    for part in export.splits:
        path = folder / "annotations" / f"instances_{part}.json"
        with contextlib.redirect_stdout(io.StringIO()):
            truth = coco.COCO(str(path))
            for annotation in truth.anns.values():
                mask = truth.annToMask(annotation)
                image = truth.imgs[annotation["image_id"]]
                if mask.shape != (image["height"], image["width"]) or not mask.any():
                    raise DatasetError(f"{path}: the mask of annotation {annotation['id']} is empty or of a wrong size")
                masks += 1
            if not truth.anns:
                continue
            found = truth.loadRes([{**row, "score": 1.0} for row in truth.dataset["annotations"]])
            for kind in ("bbox", "segm"):
                run = evaluation.COCOeval(truth, found, kind)
                run.evaluate()
                run.accumulate()
                run.summarize()
                if run.stats[0] < 0.9999:
                    raise DatasetError(
                        f"{path}: the truth against itself gives {kind} AP {run.stats[0]:.4f} instead of 1"
                    )
    return f"pycocotools: {masks} masks decoded, truth against itself AP 1.0 (bbox and segm)"


def with_supervision_coco(folder: Path, export: Export) -> str:
    """COCO, a second opinion."""
    supervision = _import("supervision", "pip install 'tagmill[check]'")
    count = 0
    for part in export.splits:
        found = supervision.DetectionDataset.from_coco(
            str(folder / "images" / part), str(folder / "annotations" / f"instances_{part}.json")
        )
        count += sum(len(detections) for detections in found.annotations.values())
    return _counted("supervision", count, export)


def with_supervision_yolo(folder: Path, export: Export) -> str:
    """YOLO detection and OBB, a second opinion."""
    supervision = _import("supervision", "pip install 'tagmill[check]'")
    count = 0
    for part in export.splits:
        found = supervision.DetectionDataset.from_yolo(
            str(folder / "images" / part),
            str(folder / "labels" / part),
            str(folder / "data.yaml"),
            is_obb=export.name == "yolo-obb",
        )
        count += sum(len(detections) for detections in found.annotations.values())
        if list(found.classes) != list(export.classes):
            raise DatasetError(f"supervision reads classes {found.classes} instead of {list(export.classes)}")
    return _counted("supervision", count, export)


def _counted(who: str, count: int, export: Export) -> str:
    wanted = sum(len(shot.targets) for shot in export.shots)
    if count != wanted:
        raise DatasetError(f"{who} finds {count} targets instead of {wanted}")
    return f"{who}: {count} targets read"


def with_ultralytics(folder: Path, export: Export) -> str:
    """YOLO: Ultralytics' own verdict on each picture and label. It is AGPL and never installed by tagmill."""
    utils = _import("ultralytics.data.utils", "AGPL-3.0; install it yourself if that suits you")
    if "val" not in export.splits:
        raise Absent("ultralytics takes no data set without a validation set, so it was not asked")
    data = utils.check_det_dataset(str(folder / "data.yaml"), autodownload=False)
    pose = export.name == "yolo-pose"
    points, dimensions = data.get("kpt_shape", (0, 0))
    corrupt, found = [], 0
    for shot in export.shots:
        image = str(folder / "images" / shot.split / f"{shot.stem}.{shot.change.extension}")
        label = str(folder / "labels" / shot.split / f"{shot.stem}.txt")
        row = utils.verify_image_label((image, label, "", pose, len(export.classes), points, dimensions, False))
        found += 0 if row[1] is None else len(row[1])
        if row[-2]:
            corrupt.append(f"{shot.stem}: {row[-1]}")
    if corrupt:
        raise DatasetError(f"ultralytics finds {len(corrupt)} corrupt, the first is {corrupt[0]}")
    if found != (wanted := sum(len(shot.targets) for shot in export.shots)):
        raise DatasetError(f"ultralytics finds {found} targets instead of {wanted}")
    return f"ultralytics: {len(export.shots)} pictures with {found} targets, 0 corrupt"


def with_own_bop_rules(folder: Path, export: Export) -> str:
    """BOP without its toolkit."""
    return check_bop(folder, export.splits)


def with_bop_toolkit(folder: Path, export: Export) -> str:
    """BOP: the toolkit reads every scene."""
    inout = _import("bop_toolkit_lib.inout", "not on PyPI; see github.com/thodan/bop_toolkit")
    parts = export.splits
    scenes = sorted(path.parent for path in folder.glob("*/*/scene_gt.json") if path.parents[1].name in parts)
    count = 0
    for scene in scenes:
        truth = inout.load_scene_gt(str(scene / "scene_gt.json"))
        cameras = inout.load_scene_camera(str(scene / "scene_camera.json"))
        if truth.keys() != cameras.keys():
            raise DatasetError(f"{scene}: bop_toolkit reads other pictures in scene_gt than in scene_camera")
        count += sum(len(rows) for rows in truth.values())
    return f"bop_toolkit: {len(scenes)} scenes with {np.int64(count)} objects read"


_YOLO: tuple[Loader, ...] = (with_ultralytics, with_supervision_yolo)
LOADERS: dict[str, tuple[Loader, ...]] = {
    "yolo": _YOLO,
    "yolo-obb": _YOLO,
    "yolo-segment": _YOLO,
    "yolo-pose": (with_ultralytics,),
    "coco": (with_pycocotools, with_supervision_coco),
    "bop": (with_own_bop_rules, with_bop_toolkit),
}
"""By format; more than one: a second opinion."""
