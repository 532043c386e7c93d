"""BOP's ``scene_gt_coco.json``: a scene's visible masks in COCO's form, as bop_toolkit's calc_gt_coco.py has it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

LEAST_VISIBLE = 0.1
"""An object of which less can be seen is to be ignored."""


class SceneCoco:
    """One scene's document. Image ids are the scene's picture numbers, category ids its object ids."""

    def __init__(self, names: Mapping[int, str]) -> None:
        """``names``: each object id's class."""
        self._images: list[dict[str, Any]] = []
        self._annotations: list[dict[str, Any]] = []
        self._categories = [{"id": number, "name": name, "supercategory": "tagmill"} for number, name in names.items()]

    def add(
        self,
        image: int,
        file_name: str,
        size: tuple[int, int],
        objects: Sequence[int],
        info: Sequence[Mapping[str, Any]],
        runs: Sequence[Sequence[int]],
    ) -> None:
        """One picture; ``size``: width, height; ``info``: its rows of ``scene_gt_info``, ``runs``: of visible masks."""
        width, height = size
        self._images.append({"id": image, "file_name": file_name, "width": width, "height": height})
        for category, about, counts in zip(objects, info, runs, strict=True):
            self._annotations.append(
                {
                    "id": len(self._annotations) + 1,
                    "image_id": image,
                    "category_id": category,
                    "iscrowd": 0,
                    "area": about["px_count_visib"],
                    "bbox": about["bbox_obj"],
                    "segmentation": {"counts": list(counts), "size": [height, width]},
                    "width": width,
                    "height": height,
                    "ignore": about["visib_fract"] < LEAST_VISIBLE,
                }
            )

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "info": {"description": "Exported by tagmill"},
            "licenses": [],
            "categories": self._categories,
            "images": self._images,
            "annotations": self._annotations,
        }
