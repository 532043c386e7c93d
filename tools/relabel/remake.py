"""One sample made again from its original; what the worker processes of `tagmill relabel` do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from common.dataset import SessionReader, sync_folder
from common.dataset.derive import link_pictures
from common.dataset.layout import PictureKind
from common.errors import TagmillError
from common.labels import Label
from services.label.exact import ExactLabels, versions
from services.label.history import around_of, kept
from services.label.verdict import verdict
from services.store.disk import RESERVE_BYTES
from services.store.sample import write_sample
from tools.relabel.carry import Described, carried
from tools.relabel.recipe import Recipe

_KEPT: tuple[PictureKind, ...] = ("depth", "original")


@dataclass(frozen=True)
class Job:
    """A session to make again in the folder ``staging``, as the session ``name``."""

    source: Path
    staging: Path
    name: str
    recipe: Recipe


@dataclass(frozen=True)
class Remade:
    """What became of a sample: made (``code`` None), or left out, why (``code``, ``message``)."""

    sample: str
    code: str | None = None
    message: str | None = None


class Remaker:
    """Makes samples of one session again; keeps nothing from one to the next."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._reader = SessionReader(job.source)
        self._labels: ExactLabels = job.recipe.labels()

    def remake(self, sample: str) -> Remade:
        """Make one sample durable; raises OSError, and RefusedError ``disk_full``.

        A sample whose files can't be read, or whose frame is no sample under the new rig, is left out.
        """
        reader = self._reader
        try:
            label = reader.label(sample)
            bgr, depth = reader.original(label), reader.depth(label)
        except TagmillError as error:
            return Remade(sample, error.code, error.message)
        if bgr is None or label.made_from is None:
            return Remade(sample, "no_original", f"{sample} was recorded without its original")
        recipe, made_from = self._job.recipe, label.made_from
        try:
            camera = recipe.camera(label.camera)
        except TagmillError as error:
            return Remade(sample, error.code, error.message)
        before = Described({box.name: box for box in recipe.before}, label.camera)
        now = Described({box.name: box for box in recipe.boxes}, camera)
        around = carried(around_of(made_from), before, now)
        unit = None if label.depth is None else label.depth.unit_mm
        finished = self._labels.finish(bgr, depth, unit, camera, made_from.markers, around)
        refusal = verdict(finished, background=label.background)
        if refusal is not None:
            return Remade(sample, refusal.code, refusal.message)
        again = label.model_copy(
            update={
                "session": self._job.name,
                "camera": camera,
                "objects": finished.objects,
                "left_out": finished.left_out,
                "missing": finished.missing,
                "complete": not finished.missing,
                "inpainted": finished.inpainted,
                "made_from": kept(made_from.markers, around),
                "versions": versions(),
            }
        )
        return self._stored(again, label, bgr)

    def _stored(self, again: Label, label: Label, bgr: NDArray[np.uint8]) -> Remade:
        staging = self._job.staging
        linked = link_pictures(staging, self._reader, label, _KEPT)
        for kind in linked:
            sync_folder(staging / kind)
        write_sample(staging, again, {"rgb": bgr}, RESERVE_BYTES, self._job.recipe.coding, kept=linked)
        return Remade(again.sample)


_remaker: Remaker | None = None


def prepare(job: Job) -> None:
    """Make this process a worker: one thread, as the label service's are."""
    global _remaker
    cv2.setNumThreads(1)
    _remaker = Remaker(job)


def work(sample: str) -> Remade | TagmillError | OSError:
    """Make one sample; what ends the whole (a full disk) comes back as its error."""
    assert _remaker is not None
    try:
        return _remaker.remake(sample)
    except (TagmillError, OSError) as error:
        return error
