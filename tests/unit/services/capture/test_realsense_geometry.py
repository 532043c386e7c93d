"""Factory intrinsics and aligned depth, held to the SDK's own projection and to a reprojection in numpy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pyrealsense2 as rs
import pytest

from common.errors import ConfigError
from common.geometry import CameraModel
from services.capture.cameras.realsense_alignment import DepthAligner
from services.capture.cameras.realsense_geometry import camera_model
from services.capture.cameras.realsense_modes import Wish
from services.capture.cameras.realsense_streams import RecordedStream
from tests.support.realsense_recordings import Build, Depth, Lens, record

STRONG = (0.12, -0.25, 0.004, -0.003, 0.08)
"""Ten times a real one's tangential distortion."""
REAL = (-0.0557, 0.0668, -0.0004, 0.0007, -0.0216)
"""Of the size of a D455's colour camera."""
FISHEYE = (0.02, -0.01, 0.003, 0.0, 0.0)


def pixels_of(lens: Lens) -> np.ndarray:
    across, down = np.meshgrid(np.linspace(0, lens.width - 1, 17), np.linspace(0, lens.height - 1, 11))
    return np.column_stack([across.ravel(), down.ravel()])


def rays_by_the_sdk(lens: Lens, pixels: np.ndarray) -> np.ndarray:
    """Points at z = 1. The SDK can't deproject ``modified_brown_conrady``, which it projects as the inverse one."""
    known = replace(lens, distortion=lens.distortion.replace("modified", "inverse")).intrinsics()
    return np.array([rs.rs2_deproject_pixel_to_point(known, [float(u), float(v)], 1.0) for u, v in pixels])


def pixels_by_the_sdk(lens: Lens, points: np.ndarray) -> np.ndarray:
    known = lens.intrinsics()
    return np.array([rs.rs2_project_point_to_pixel(known, [float(value) for value in point]) for point in points])


@pytest.mark.parametrize(
    ("distortion", "coefficients", "within_px"),
    [
        ("none", (0.0,) * 5, 1e-3),
        ("brown_conrady", REAL, 1e-3),
        ("brown_conrady", STRONG, 1e-3),
        ("inverse_brown_conrady", REAL, 6e-3),
        ("inverse_brown_conrady", STRONG, 0.15),
        ("modified_brown_conrady", REAL, 6e-3),
        ("modified_brown_conrady", STRONG, 0.15),
        ("kannala_brandt4", FISHEYE, 1e-3),
    ],
)
def test_intrinsics_project_as_the_sdk_does(distortion: str, coefficients: tuple[float, ...], within_px: float) -> None:
    lens = Lens(1280, 720, 910.0, distortion, coefficients)
    model = camera_model(lens.intrinsics())
    assert model.model == ("fisheye" if distortion == "kannala_brandt4" else "pinhole")
    pixels = pixels_of(lens)
    points = rays_by_the_sdk(lens, pixels)
    assert np.abs(pixels_by_the_sdk(lens, points) - pixels).max() < 1e-3, "what the SDK says of itself"
    ours, front = model.project(points * 1000)
    assert front.all()
    assert np.abs(ours - pixels).max() < within_px
    back = model.normalise(pixels)
    assert np.abs(back - points[:, :2]).max() * 910 < within_px + 0.01


@pytest.mark.parametrize(("coefficients", "better"), [(REAL, 3.0), (STRONG, 1.2)])
def test_as_they_stand_the_coefficients_of_the_inverse_model_would_be_further_off(
    coefficients: tuple[float, ...], better: float
) -> None:
    lens = Lens(1280, 720, 910.0, "inverse_brown_conrady", coefficients)
    pixels = pixels_of(lens)
    points = rays_by_the_sdk(lens, pixels)
    fitted = camera_model(lens.intrinsics())
    plain = CameraModel(1280, 720, fitted.matrix, np.array(coefficients))
    off = [float(np.sqrt(np.mean((model.project(points * 1000)[0] - pixels) ** 2))) for model in (fitted, plain)]
    assert off[0] * better < off[1]


def test_a_model_that_opencv_doesnt_know_is_refused() -> None:
    with pytest.raises(ConfigError, match="ftheta has no counterpart in OpenCV"):
        camera_model(Lens(640, 480, 400.0, "ftheta", (0.9, 0, 0, 0, 0)).intrinsics())


NORMAL = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
TURN = cv2.Rodrigues(np.array([0.02, -0.03, 0.01]))[0]


def plane_seen_by(lens: Lens, unit_mm: float) -> Depth:
    """A tilted plane, 1 m away on the depth camera's axis, in steps."""
    across, down = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
    x = (across - (lens.width - 1) / 2) / lens.focal
    y = (down - (lens.height - 1) / 2) / lens.focal
    z_mm = 1000 * NORMAL[2] / (NORMAL[0] * x + NORMAL[1] * y + NORMAL[2])
    return np.asarray(np.round(z_mm / unit_mm), dtype=np.uint16)


@pytest.mark.parametrize(
    ("distortion", "coefficients"),
    [
        ("none", (0.0,) * 5),
        ("brown_conrady", STRONG),
        ("inverse_brown_conrady", STRONG),
        ("modified_brown_conrady", STRONG),
        ("kannala_brandt4", FISHEYE),
    ],
)
@pytest.mark.parametrize("turn", [np.eye(3), TURN], ids=["parallel", "turned"])
def test_depth_is_where_and_what_the_colour_camera_would_measure(
    tmp_path: Path, distortion: str, coefficients: tuple[float, ...], turn: np.ndarray
) -> None:
    """Against the plane itself, met by each pixel's ray as the SDK's own deprojection has it."""
    unit_mm, shift = 0.25, (15.0, 1.0, -2.0)
    colour, depth = Lens(640, 360, 460.0, distortion, coefficients), Lens(424, 240, 300.0)
    build = Build(colour, depth, unit_mm=unit_mm, rotation=turn, translation_mm=shift)
    picture = np.zeros((colour.height, colour.width, 3), np.uint8)
    record(tmp_path / "plane.db3", [(picture, plane_seen_by(depth, unit_mm))], build)
    stream = RecordedStream(tmp_path / "plane.db3", Wish())
    assert stream.depth is not None
    found = DepthAligner(stream.colour.profile, stream.depth.profile, unit_mm).align(stream.next(5.0).frameset)
    stream.close()
    assert (found.shape, found.dtype) == ((360, 640), np.uint16)

    pixels = pixels_of(colour)
    rays = rays_by_the_sdk(colour, pixels)
    normal = turn @ NORMAL
    on_plane = turn @ np.array([0.0, 0.0, 1000.0]) + shift
    true_mm = (normal @ on_plane) / (rays @ normal)
    at = np.round(pixels).astype(int)
    measured_mm = found[at[:, 1], at[:, 0]] * unit_mm
    seen = measured_mm > 0
    # Beyond the depth camera's sight there is nothing, and what a fisheye sees far aside the SDK doesn't align.
    assert seen.mean() > (0.6 if distortion == "kannala_brandt4" else 0.8)
    # Depth is that of the nearest of the depth camera's pixels, each 3 mm wide on a plane that falls by 0.36.
    pixel_mm = true_mm / depth.focal * np.hypot(*NORMAL[:2]) / NORMAL[2]
    assert (np.abs(measured_mm - true_mm) < 2 * pixel_mm)[seen].all()
    assert abs(np.median((measured_mm - true_mm)[seen])) < np.median(pixel_mm)


def test_what_is_invalid_stays_invalid(tmp_path: Path) -> None:
    build = Build(Lens(160, 120, 130.0), Lens(160, 120, 130.0), rotation=TURN, translation_mm=(0.0, 0.0, 3.0))
    nothing = np.zeros((120, 160), np.uint16)
    record(tmp_path / "dark.db3", [(np.zeros((120, 160, 3), np.uint8), nothing)], build)
    stream = RecordedStream(tmp_path / "dark.db3", Wish())
    assert stream.depth is not None
    aligner = DepthAligner(stream.colour.profile, stream.depth.profile, 1.0)
    assert not aligner.align(stream.next(5.0).frameset).any()
    stream.close()
