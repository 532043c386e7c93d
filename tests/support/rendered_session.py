"""Sessions as the stack would have recorded them, made without it: rendered, detected, labelled, erased, stored."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np

from common import clock
from common.config.differences import plain_family, plain_objects
from common.config.models import InpaintConfig, PoseConfig, RecordConfig
from common.dataset import LABELS, SESSION_FILE, SessionFile
from common.geometry import Box, BoxSide, CameraModel, MarkerOnSide
from common.ids import sample_name
from common.labels import CameraLabel, DepthLabel, Erased, Label
from common.ledgers import CameraLedger, Ledger, RecordingSpec
from common.markers import family
from common.scene import Scene, SceneCamera
from services.detect.markers import MarkerDetector, open_detector
from services.label.exact import ExactLabels, Options, versions
from services.label.history import kept
from services.label.labelling import ALONE
from services.label.verdict import verdict
from services.store.sample import write_sample

FAMILY = family("apriltag_36h11", Path())
START_NS = 1_788_000_000_000_000_000
FRAME_NS = 33_333_333
RECORDING = "rec-20260829T104640-0001"


def box(name: str, kind: str, first: int) -> Box:
    """A box of 260 x 200 x 160 mm with a large marker on each of its five sides."""
    sides = tuple(
        BoxSide(face, face, (MarkerOnSide(first + number, 60, 10, (right, up, 0.0)),))
        for number, (face, right, up) in enumerate(
            (("front", -60, 40), ("back", 70, -30), ("left", 20, 30), ("right", 0, 0), ("top", -20, 0))
        )
    )
    return Box(name, kind, (260.0, 200.0, 160.0), sides)


BOXES = (box("box-1", "carton", 0), box("box-2", "crate", 10))


def camera(width: int = 640, height: int = 360) -> CameraModel:
    """A camera with a lens, of any size."""
    focal = 0.72 * width
    matrix = np.array([[focal, 0, width / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1.0]])
    return CameraModel(width, height, matrix, np.array([0.05, -0.08, 0.0005, -0.0005, 0.02]))


@dataclass(frozen=True)
class Plan:
    """What to record: every ``apart``-th frame of the scene's path; ``boxes``: as the rig describes the objects."""

    folder: Path
    apart: int = 6
    seed: int = 1
    width: int = 640
    height: int = 360
    depth: bool = True
    original: bool = False
    name: str = "cam0"
    boxes: tuple[Box, ...] = BOXES


def record_session(plan: Plan, count: int, workers: int = 2) -> tuple[str, ...]:
    """Record ``count`` samples; returns their names. A frame without a sure pose of both objects is passed over."""
    for name in ("rgb", "depth", LABELS):
        (plan.folder / name).mkdir(parents=True, exist_ok=True)
    parts = [range(index, count, workers) for index in range(workers)]
    if workers == 1:
        names = _record(plan, parts[0])
    else:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            names = [name for part in pool.map(partial(_record, plan), parts) for name in part]
    spec = RecordingSpec(recording=RECORDING, mode="all", cameras=(plan.name,), started_at=clock.iso_utc(START_NS))
    account = CameraLedger(
        captured=count, labelled=len(names), recorded=len(names), refused={"no_object": count - len(names)}
    )
    ledger = Ledger(spec=spec, phase="ended", cameras={plan.name: account})
    rig = {"markers": plain_family(FAMILY.name, Path()), "objects": plain_objects(plan.boxes), "cameras": {}}
    file = SessionFile(
        name=plan.folder.name,
        created_at=clock.iso_utc(START_NS),
        rig=rig,
        versions={"tagmill": "0"},
        recordings={RECORDING: ledger},
    )
    (plan.folder / SESSION_FILE).write_bytes(file.to_bytes())
    return tuple(sorted(names))


def _record(plan: Plan, numbers: range) -> list[str]:
    cv2.setNumThreads(1)
    model = camera(plan.width, plan.height)
    frustum = (plan.width / 2 / float(model.matrix[0, 0]), plan.height / 2 / float(model.matrix[1, 1]))
    scene = SceneCamera(Scene(BOXES, FAMILY, plan.seed, frustum=frustum, distance_mm=700.0), model)
    detector = open_detector(FAMILY, Path())
    exact = ExactLabels(plan.boxes, FAMILY, Options(PoseConfig(), InpaintConfig(), RecordConfig()))
    return list(filter(None, (_sample(plan, number, scene, exact, detector) for number in numbers)))


def _sample(plan: Plan, number: int, scene: SceneCamera, exact: ExactLabels, detector: MarkerDetector) -> str | None:
    frame = number * plan.apart
    shot = scene.render(frame, depth=plan.depth)
    markers = tuple(detector.detect(cv2.cvtColor(shot.bgr, cv2.COLOR_BGR2GRAY)))
    label, original = _label(plan, frame, scene.camera), shot.bgr.copy()
    finished = exact.finish(shot.bgr, shot.depth, 1.0 if plan.depth else None, label.camera, markers, ALONE)
    if verdict(finished, background=False) is not None:
        return None
    label = label.model_copy(
        update={
            "objects": finished.objects,
            "left_out": finished.left_out,
            "inpainted": finished.inpainted,
            "made_from": kept(markers, ALONE) if plan.original else None,
            "versions": versions(),
        }
    )
    pictures = {"rgb": shot.bgr} | ({"depth": shot.depth} if plan.depth else {})
    write_sample(plan.folder, label, pictures | ({"original": original} if plan.original else {}), reserve=0)
    return label.sample


def _label(plan: Plan, frame: int, model: CameraModel) -> Label:
    wall = START_NS + frame * FRAME_NS
    return Label(
        sample=sample_name(wall, plan.name, frame),
        session=plan.folder.name,
        recording=RECORDING,
        camera=CameraLabel(
            name=plan.name,
            width=model.width,
            height=model.height,
            matrix=tuple(map(tuple, model.matrix.tolist())),
            distortion=tuple(model.distortion.tolist()),
        ),
        frame=frame,
        boot="abcd1234",
        source_name=None,
        captured_at=clock.iso_utc(wall),
        captured_wall_ns=wall,
        captured_mono_ns=frame * FRAME_NS,
        device_ns=None,
        depth=DepthLabel(unit_mm=1.0) if plan.depth else None,
        background=False,
        objects=(),
        left_out=(),
        inpainted=Erased(method="plane", margin="0.15", polygons=()),
        versions={"tagmill": "0"},
    )


def labels_of(folder: Path) -> Iterator[Path]:
    """The label files, oldest first."""
    return iter(sorted((folder / LABELS).iterdir()))
