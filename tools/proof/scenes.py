"""The pictures: rooms in which one carton turns, with its markers and, the same frames once more, without any."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from common.config import load_rig
from common.errors import DatasetError
from common.geometry import Box, CameraModel
from common.markers import family
from common.scene import Rendered, Scene, SceneCamera
from common.scene.objects import BoxDrawing
from services.label.visibility import facing_side
from services.label.windows import clip_window

RIG = Path(__file__).with_name("rig.yaml")
WIDTH, HEIGHT = 640, 480
FOCAL_PX = 460.8
CAMERA = CameraModel(
    WIDTH, HEIGHT, np.array([[FOCAL_PX, 0, (WIDTH - 1) / 2], [0, FOCAL_PX, (HEIGHT - 1) / 2], [0, 0, 1]]), np.zeros(5)
)
FRUSTUM = (WIDTH / 2 / FOCAL_PX, HEIGHT / 2 / FOCAL_PX)
MARKED, BARE, DEPTH = "marked", "bare", "depth"
"""The folders of frames: what the camera sees, the same without markers, its depth."""
STEP = 25
"""Scene frames (30 to the second) from a picture to the next: a side is looked at for 150, a tour takes 600."""
TEST_STEP = 11
_TOUR = 600
_TOURS = 20
"""A test room that has not shown enough of each side after so many tours never will."""
_LOOKS = 1
"""The seed of the carton's looks: it is the same carton in every room."""
T = TypeVar("T")


@dataclass(frozen=True)
class Room:
    """A room whose frames go into ``folder``, named by its seed, which decides room, light, path and noise."""

    folder: Path
    seed: int

    def picture(self, frame: int) -> str:
        """The file name of a frame; a camera plays room after room."""
        return f"{self.seed:05d}-{frame:05d}.png"


def boxes() -> tuple[Box, ...]:
    """The objects of the rig."""
    return load_rig(RIG).boxes


def render_training(rooms: Sequence[Room], frames: int, workers: int) -> None:
    """Render ``frames`` pictures a room: folders ``marked`` and ``bare`` (BGR), ``depth`` (uint16, mm)."""
    _for_each(partial(_render_training, frames), rooms, workers)


def _for_each(render: Callable[[Room], T], rooms: Sequence[Room], workers: int) -> list[T]:
    if workers == 1:
        return [render(room) for room in rooms]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return list(pool.map(render, rooms))


def _render_training(frames: int, room: Room) -> None:
    camera = _scene_camera(room.seed)
    for name in (MARKED, BARE, DEPTH):
        (room.folder / name).mkdir(parents=True, exist_ok=True)
    for number in range(frames):
        seen = camera.render(number * STEP)
        bare = camera.render(number * STEP, markers=False, depth=False)
        assert seen.depth is not None
        for name, picture in ((MARKED, seen.bgr), (BARE, bare.bgr), (DEPTH, seen.depth)):
            write_png(room.folder / name / room.picture(number), picture)


def render_test(rooms: Sequence[Room], per_class: int, path: Path, workers: int) -> None:
    """Render marker-free pictures, ``per_class`` of each side and room; their truth goes to ``path`` (COCO)."""
    rows = [row for found in _for_each(partial(_render_test, per_class), rooms, workers) for row in found]
    names = class_names()
    truth = {
        "info": {},
        "images": [
            {"id": at, "file_name": row["file"], "width": WIDTH, "height": HEIGHT} for at, row in enumerate(rows, 1)
        ],
        "categories": [{"id": at, "name": name} for at, name in enumerate(names)],
        "annotations": [
            {
                "id": at,
                "image_id": at,
                "category_id": names.index(row["class"]),
                "bbox": row["bbox"],
                "area": row["bbox"][2] * row["bbox"][3],
                "iscrowd": 0,
            }
            for at, row in enumerate(rows, 1)
        ],
    }
    path.write_text(json.dumps(truth))


def class_names() -> tuple[str, ...]:
    """The sides with a marker, in the order of `tagmill export --classes side`."""
    return tuple(side.class_name for box in boxes() for side in box.sides)


def _render_test(per_class: int, room: Room) -> list[dict[str, Any]]:
    room.folder.mkdir(parents=True, exist_ok=True)
    camera, (box,) = _scene_camera(room.seed), boxes()
    wanted = Counter({side.class_name: per_class for side in box.sides})
    rows: list[dict[str, Any]] = []
    for index in range(0, _TOURS * _TOUR, TEST_STEP):
        pose = camera.poses(index)[box.name]
        facing = facing_side(box, pose)
        if facing is None or wanted[facing[0]] == 0:
            continue
        rendered = camera.render(index, markers=False, depth=False)
        window = _window(rendered, box)
        wanted[facing[0]] -= 1
        path = room.folder / room.picture(index)
        write_png(path, rendered.bgr)
        rows.append({"file": str(path), "class": facing[0], "bbox": window})
        if not wanted.total():
            return rows
    missing = ", ".join(f"{count} of {name}" for name, count in wanted.items() if count)
    raise DatasetError(f"the test room with seed {room.seed} never shows {missing}")


def _window(rendered: Rendered, box: Box) -> list[float]:
    """The true window as COCO has it, from the picture's edge: x, y of the top left corner, width, height."""
    (truth,) = (item for item in rendered.truth if item.name == box.name)
    window = clip_window(truth.window, CAMERA)
    assert window is not None
    return [window.x_min + 0.5, window.y_min + 0.5, window.x_max - window.x_min, window.y_max - window.y_min]


def _scene_camera(seed: int) -> SceneCamera:
    cv2.setNumThreads(1)
    rig = load_rig(RIG)
    markers = family(rig.config.markers.family, rig.folder)
    scene = Scene(rig.boxes, markers, seed, frustum=FRUSTUM)
    scene.drawings |= {box.name: BoxDrawing(box, markers, _LOOKS) for box in rig.boxes}
    return SceneCamera(scene, CAMERA)


def write_png(path: Path, picture: NDArray[Any]) -> None:
    """Write a picture; raises DatasetError if that fails."""
    if not cv2.imwrite(str(path), picture, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
        raise DatasetError(f"{path} can't be written: is the disk full?")
