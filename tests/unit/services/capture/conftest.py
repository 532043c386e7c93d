"""Pictures, videos and rigs for the tests of capture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.config import Rig, load_rig

WIDTH, HEIGHT = 64, 48


def grey_picture(value: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    return np.full((height, width, 3), value, np.uint8)


def write_pictures(folder: Path, count: int, width: int = WIDTH, height: int = HEIGHT) -> Path:
    """``img1.png`` ... in which every pixel is 10 times the number."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(1, count + 1):
        assert cv2.imwrite(str(folder / f"img{number}.png"), grey_picture(10 * number, width, height))
    return folder


def write_depths(folder: Path, count: int, width: int = WIDTH, height: int = HEIGHT) -> Path:
    """``img1.png`` ... of uint16 in which every pixel is 1000 times the number."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(1, count + 1):
        assert cv2.imwrite(str(folder / f"img{number}.png"), np.full((height, width), 1000 * number, np.uint16))
    return folder


def write_video(path: Path, count: int, fps: float = 20.0) -> Path:
    """A video whose n-th frame (from 0) has pixels of about 10 (n + 1)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, (WIDTH, HEIGHT))
    assert video.isOpened()
    for number in range(count):
        video.write(grey_picture(10 * (number + 1)))
    video.release()
    return path


def write_calibration(path: Path, width: int, height: int) -> Path:
    path.write_text(
        f"width: {width}\nheight: {height}\n"
        f"camera_matrix: [[{1.1 * width}, 0, {width / 2}], [0, {1.1 * width}, {height / 2}], [0, 0, 1]]\n"
        "distortion: [0.1, -0.2, 0.001, -0.001, 0.05]\n"
    )
    return path


@pytest.fixture
def rig_of(tmp_path: Path) -> Callable[[str], Rig]:
    """``rig_of("{driver: files, path: photos}")``: a rig with this ``cam0``."""

    def make(camera: str) -> Rig:
        path = tmp_path / "rig.yaml"
        path.write_text(f"cameras:\n  cam0: {camera}\nring: {{slots: 6}}\n")
        return load_rig(path)

    return make
