"""The exact label of a frame that is kept, and its picture without markers: what the workers of label do. Pure.

`tagmill relabel` calls the same function with the same values, which a label keeps beside its original picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from common import VERSION
from common.config.models import InpaintConfig, PoseConfig, RecordConfig
from common.geometry import Box, CameraModel
from common.labels import CameraLabel, Erased, LeftOut, Missing, ObjectLabel
from common.laps import Laps, Stopwatch
from common.markers import Family
from common.messages import DetectedMarker
from services.label.covering import covering
from services.label.inpaint import erase
from services.label.labelling import Around, Labeller
from services.label.occlusion import DepthPicture
from services.label.regions import regions_on_sides


@dataclass(frozen=True)
class Finished:
    """What became of a frame: the exact labels, what was erased, and what the rig says is to be kept nevertheless.

    ``laps``: what the labels (``refine``) and erasing took.
    """

    objects: tuple[ObjectLabel, ...]
    left_out: tuple[LeftOut, ...]
    missing: tuple[Missing, ...]
    inpainted: Erased
    keep_ambiguous: bool
    keep_incomplete: bool
    laps: Laps = field(default_factory=dict, compare=False)


@dataclass(frozen=True)
class Options:
    """The sections of a rig file on which an exact label depends beside objects and markers."""

    pose: PoseConfig
    inpaint: InpaintConfig
    record: RecordConfig


class ExactLabels:
    """Finishes frames for one rig; keeps nothing from one frame to the next."""

    def __init__(self, boxes: Sequence[Box], family: Family, options: Options) -> None:
        self._labeller = Labeller(boxes, family, options.pose)
        self._options = options

    def finish(
        self,
        bgr: NDArray[np.uint8],
        depth: NDArray[np.uint16] | None,
        depth_unit_mm: float | None,
        camera: CameraLabel,
        markers: Sequence[DetectedMarker],
        around: Around,
    ) -> Finished:
        """Label a picture (H, W, 3) exactly and erase its markers in place; ``depth`` (H, W), 0 invalid."""
        watch = Stopwatch()
        options, model = self._options.inpaint, CameraModel.from_label(camera)
        measured = None if depth is None or depth_unit_mm is None else DepthPicture(depth, depth_unit_mm)
        labelled = self._labeller.label_once(markers, model, bgr, around, measured)
        watch.lap("refine")
        found = regions_on_sides(
            labelled.objects, labelled.left_out, self._labeller.boxes, model, margin=options.margin
        )
        covered = None if measured is None else covering(found, measured)
        erase(bgr, found, method=options.method, radius_px=options.radius_px, covered=covered)
        watch.lap("erase")
        return Finished(
            objects=labelled.objects,
            left_out=labelled.left_out,
            missing=labelled.missing,
            inpainted=Erased(
                method=options.method,
                margin=f"{options.margin:g} of the marker, at least 3 px",
                polygons=tuple(region.polygon for region in found),
            ),
            keep_ambiguous=self._options.pose.ambiguous == "keep",
            keep_incomplete=self._options.record.incomplete == "keep",
            laps=watch.laps,
        )


def versions() -> dict[str, str]:
    """Of what a label depends on."""
    return {"tagmill": VERSION, "opencv": str(cv2.__version__)}
