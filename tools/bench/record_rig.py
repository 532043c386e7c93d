"""What `tagmill bench record` records: a box with two markers of about 80 px, and its frames for the plain script."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from common.config import load_rig
from common.geometry import CameraModel
from common.markers import family
from common.scene import Scene, SceneCamera

CAMERA = "cam0"
SESSION = "bench"
FRAMES = 16
"""Rendered ahead and repeated, there and back."""
SEED = 1
FPS = 30.0
_SIZE = (1280, 720)
_FOCAL_PX = 921.6
_MARKER_MM, _APART_MM = 80.0, 240.0
_BOX_MM = {"width": 400, "height": 300, "depth": 300}


def write_rig(folder: Path, root: Path, *, paced: bool, picture_format: str) -> Path:
    """A rig whose camera gives 30 frames/s, or (``paced``) the next one as soon as the last is labelled."""
    markers = [
        {"marker": number, "marker_size_mm": _MARKER_MM, "border_mm": 10, "offset_mm": [side * _APART_MM / 2, 0]}
        for number, side in enumerate((-1, 1))
    ]
    camera: dict[str, Any] = {
        "driver": "synthetic",
        "width": _SIZE[0],
        "height": _SIZE[1],
        "fps": FPS,
        "seed": SEED,
        "focal_px": _FOCAL_PX,
        "distortion": [],
        "prerendered": FRAMES,
        "pace": "consumer" if paced else "fps",
    }
    rig = {
        "dataset": {"root": str(root), "session": SESSION, "format": picture_format},
        "objects": [{"name": "box-1", "size_mm": _BOX_MM, "sides": {"front": {"markers": markers}}}],
        "network": {"console": None},
        "cameras": {CAMERA: camera},
    }
    path = folder / ("paced.yaml" if paced else "camera.yaml")
    path.write_text(yaml.safe_dump(rig))
    return path


def render(rig_file: Path) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
    """The very frames that the rig's camera repeats: colour (N, H, W, 3), depth (N, H, W)."""
    rig = load_rig(rig_file)
    width, height = _SIZE
    matrix = np.array([[_FOCAL_PX, 0, (width - 1) / 2], [0, _FOCAL_PX, (height - 1) / 2], [0, 0, 1]])
    frustum = (width / 2 / _FOCAL_PX, height / 2 / _FOCAL_PX)
    scene = Scene(rig.boxes, family(rig.config.markers.family, rig.folder), SEED, frustum=frustum)
    camera = SceneCamera(scene, CameraModel(width, height, matrix, np.zeros(5)))
    frames = [camera.render(index) for index in range(FRAMES)]
    depths = [frame.depth for frame in frames if frame.depth is not None]
    return np.stack([frame.bgr for frame in frames]), np.stack(depths)


def save_for_script(rig_file: Path, folder: Path) -> None:
    """Frames, intrinsics and the markers' corners on the box (mm), as the plain script reads them."""
    colour, depth = render(rig_file)
    width, height = _SIZE
    half = _MARKER_MM / 2
    square = np.array([[-half, 0, half], [half, 0, half], [half, 0, -half], [-half, 0, -half]])
    front = -_BOX_MM["depth"] / 2
    corners = np.stack([np.add(square, (side * _APART_MM / 2, front, 0)) for side in (-1, 1)])
    size = np.array([_BOX_MM[key] for key in ("width", "depth", "height")]) / 2
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    matrix = np.array([[_FOCAL_PX, 0, (width - 1) / 2], [0, _FOCAL_PX, (height - 1) / 2], [0, 0, 1]])
    np.savez(folder / "frames.npz", colour=colour, depth=depth, matrix=matrix, marker_corners=corners, box=signs * size)
