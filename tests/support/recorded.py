"""A recorded session without a stack: painted pictures with labels from the truth, fast.

Two boxes with four sides each on a smooth path before a camera with a lens; 320x240. The label is made by the same
functions as the label service's (``services.label.describe``), the files by the store's (``write_sample``).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from common import clock
from common.config.differences import plain_objects
from common.dataset import FOLDERS, SESSION_FILE, SessionFile, label_path, picture_path
from common.geometry import FACES, Box, BoxSide, CameraModel, MarkerOnSide, Pose
from common.ids import sample_name
from common.labels import (
    CameraLabel,
    DepthLabel,
    Erased,
    FaceName,
    Label,
    Missing,
    SampleFiles,
    StoredFile,
    Uncertainty,
)
from services.label.describe import Posed, object_label, what_is_seen

WIDTH, HEIGHT = 320, 240
Sample = tuple[Label, dict[str, np.ndarray]]
START_NS = 1_788_000_000_000_000_000
STEP_NS = 2_000_000_000
"""Two seconds between samples: a recording with `every_s: 2`."""
MATRIX = np.array([[230.0, 0, 161.5], [0, 229.0, 118.25], [0, 0, 1.0]])
LENS = np.array([0.08, -0.15, 0.0005, -0.0005, 0.05])


def make_box(
    name: str, first: int, type_: str = "box", size: tuple[float, float, float] = (400.0, 300.0, 300.0)
) -> Box:
    """A box with a marker on each of its four sides."""
    sides = tuple(
        BoxSide(side, side, (MarkerOnSide(first + i, 50, 10),))
        for i, side in enumerate(("front", "back", "left", "right"))
    )
    return Box(name, type_, size, sides)


BOXES = (make_box("box-1", 0), make_box("box-2", 10, "carton", (300.0, 200.0, 250.0)))


def camera_label(name: str = "cam0", distortion: Sequence[float] = tuple(LENS)) -> CameraLabel:
    """The camera of these sessions."""
    rows = tuple((float(a), float(b), float(c)) for a, b, c in MATRIX)
    return CameraLabel(name=name, width=WIDTH, height=HEIGHT, matrix=rows, distortion=tuple(map(float, distortion)))


def label_of(
    number: int, poses: dict[str, Pose], boxes: Sequence[Box] = BOXES, camera: CameraLabel | None = None, **more: Any
) -> Label:
    """The label of sample ``number``, as the label service would write it; ``poses``: object to camera."""
    camera = camera or camera_label()
    model = CameraModel.from_label(camera)
    posed = [Posed(box, poses[box.name], None, "measured", _bar()) for box in boxes if box.name in poses]
    seen = what_is_seen(posed, model, None)
    wall = START_NS + number * STEP_NS
    plain: dict[str, Any] = {
        "sample": sample_name(wall, camera.name, number),
        "session": "s",
        "recording": "rec-a",
        "camera": camera,
        "frame": number,
        "boot": "abcd1234",
        "source_name": None,
        "captured_at": clock.iso_utc(wall),
        "captured_wall_ns": wall,
        "captured_mono_ns": number + 1,
        "device_ns": None,
        "depth": None,
        "background": not posed,
        "objects": tuple(
            object_label(i, item, model, see) for i, (item, see) in enumerate(zip(posed, seen, strict=True))
        ),
        "left_out": (),
        "inpainted": Erased(method="plane", margin="0.15", polygons=()),
        "versions": {"tagmill": "0"},
    }
    return Label(**(plain | more))


def incomplete(label: Label) -> Label:
    """The same with an object missing."""
    missing = (Missing(object="box-2", reason="not_detected"),)
    return label.model_copy(update={"complete": False, "missing": missing})


def write_session(
    folder: Path,
    samples: Iterable[Sample],
    boxes: Sequence[Box] = BOXES,
    markers: str = "apriltag_36h11",
) -> list[str]:
    """A session of these labels with their pictures (``rgb``, perhaps ``depth``); not fsynced."""
    for name in FOLDERS:
        (folder / name).mkdir(parents=True, exist_ok=True)
    rig = {"markers": {"family": markers}, "objects": plain_objects(boxes), "cameras": {}}
    about = SessionFile(name=folder.name, created_at="2026-08-30T12:00:00.000Z", rig=rig, versions={})
    (folder / SESSION_FILE).write_bytes(about.to_bytes())
    names = []
    for label, pictures in samples:
        files = {}
        for kind, pixels in pictures.items():
            data = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
            path = picture_path(kind, label.sample, "png")  # type: ignore[arg-type]
            (folder / path).write_bytes(data)
            files[kind] = StoredFile(path=str(path), size=len(data), sha256=hashlib.sha256(data).hexdigest())
        whole = label.model_copy(update={"files": SampleFiles(**files)})
        (folder / label_path(label.sample)).write_text(whole.model_dump_json(by_alias=True, indent=1))
        names.append(label.sample)
    return names


def moving(number: int, step: float = 1.0) -> dict[str, Pose]:
    """Where the boxes are in sample ``number``: each turns and wanders; box-1 is often before box-2, never in it."""
    at = number * step
    one = Pose.from_rvec([0.25 * np.sin(0.31 * at), 0.0, 0.0], np.zeros(3)).after(_upright(0.9 * at))
    two = Pose.from_rvec([0.0, 0.0, 0.2 * np.sin(0.17 * at)], np.zeros(3)).after(_upright(2.0 + 1.3 * at))
    return {
        "box-1": Pose(
            one.rotation, np.array([-250 + 900 * np.sin(0.7 * at), 60 * np.cos(at), 1500 + 150 * np.sin(at)])
        ),
        "box-2": Pose(two.rotation, np.array([260 + 1300 * np.sin(0.41 * at), -50.0, 2500 + 250 * np.sin(0.23 * at)])),
    }


def _upright(turn: float) -> Pose:
    """A box that faces the camera, turned about its own vertical axis (rad), seen a little from above."""
    upright = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    about = Pose.from_rvec([0.0, 0.0, turn], np.zeros(3))
    return Pose.from_rvec([0.35, 0.0, 0.0], np.zeros(3)).after(Pose(upright, np.zeros(3))).after(about)


class Painter:
    """Draws the boxes' faces in plain colours, with the lens; depth from the faces' planes."""

    def __init__(self, camera: CameraLabel | None = None) -> None:
        self.camera = CameraModel.from_label(camera or camera_label())
        x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        rays = self.camera.normalise(np.column_stack([x.ravel(), y.ravel()]).astype(float))
        self._rays = np.column_stack([rays, np.ones(len(rays))]).reshape(HEIGHT, WIDTH, 3)
        self._room = np.random.default_rng(5).integers(40, 200, (12, 16, 3), dtype=np.uint8)

    def paint(self, poses: dict[str, Pose], boxes: Sequence[Box] = BOXES, light: int = 0) -> dict[str, np.ndarray]:
        """``rgb`` (H, W, 3) uint8 and ``depth`` (H, W) uint16 in mm."""
        bgr = cv2.resize(np.roll(self._room, light, axis=1), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
        depth = np.full((HEIGHT, WIDTH), 4000.0)
        for box in boxes:
            for number, face in enumerate(FACES):
                if box.name in poses:
                    self._face(bgr, depth, box, face, poses[box.name], number)
        return {"rgb": bgr, "depth": depth.round().astype(np.uint16)}

    def _face(self, bgr: np.ndarray, depth: np.ndarray, box: Box, face: FaceName, pose: Pose, number: int) -> None:
        frame = pose.after(box.face_pose(face))
        normal = frame.rotation[:, 2]
        if normal @ frame.translation >= 0:
            return
        rim, _ = self.camera.project(pose.apply(box.face_polygon(face)))
        (x0, y0), (x1, y1) = (
            np.clip(edge, 0, [WIDTH, HEIGHT]).astype(int) for edge in (rim.min(axis=0) - 4, rim.max(axis=0) + 5)
        )
        part = slice(y0, y1), slice(x0, x1)
        rays = self._rays[part]
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (normal @ frame.translation) / (rays @ normal)
        on_face = (rays * z[..., None] - frame.translation) @ frame.rotation
        width, height, _ = box.face_size(face)
        inside = (np.abs(on_face[..., 0]) <= width / 2) & (np.abs(on_face[..., 1]) <= height / 2)
        inside &= (z > 1) & (z < depth[part])
        depth[part][inside] = z[inside]
        bgr[part][inside] = [30 + 35 * number, 220 - 30 * number, 90 + 20 * (len(box.type) % 5)]


def samples(count: int, *, first: int = 0, step: float = 1.0, depth: bool = True) -> Iterator[Sample]:
    """``count`` samples of the moving boxes; a small ``step`` makes neighbours near-duplicates."""
    painter, unit = Painter(), DepthLabel(unit_mm=1.0) if depth else None
    for number in range(first, first + count):
        poses = moving(number, step)
        pictures = painter.paint(poses)
        yield label_of(number, poses, depth=unit), pictures if depth else {"rgb": pictures["rgb"]}


def _bar() -> Uncertainty:
    return Uncertainty(distance_mm=1.5, rotation_deg=0.3, corners_px=(0.2,) * 8)
