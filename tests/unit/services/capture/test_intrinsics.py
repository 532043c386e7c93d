"""Fitting a calibration to the size of the pictures."""

from __future__ import annotations

import numpy as np
import pytest

from common.errors import CameraError
from common.geometry import CameraModel
from services.capture.cameras.intrinsics import fit_to_size, known_or_factory, known_or_guessed, label_of

CALIBRATED = CameraModel(
    1280, 960, np.array([[1000.0, 0, 650], [0, 990, 470], [0, 0, 1]]), np.array([0.1, -0.2, 0.001, -0.002, 0.03])
)
LABEL = label_of("cam0", CALIBRATED, intrinsics_from="calibration", serial="7")


def test_the_size_it_was_made_for_changes_nothing() -> None:
    assert fit_to_size(LABEL, 1280, 960) == (LABEL, ())


@pytest.mark.parametrize(("width", "height"), [(640, 480), (320, 240), (2560, 1920)])
def test_a_scaled_picture_shows_a_point_where_scaling_puts_its_pixel(width: int, height: int) -> None:
    scaled, warnings = fit_to_size(LABEL, width, height)
    points = np.array([[0, 0, 1000.0], [300, -200, 1000], [-400, 250, 900]])
    before, _ = CALIBRATED.project(points)
    after, _ = CameraModel.from_label(scaled).project(points)
    # A pixel is an area, its centre the integer: edges scale, i.e. x + 0.5.
    assert np.allclose((before + 0.5) * (width / 1280) - 0.5, after, atol=1e-9)
    assert (scaled.width, scaled.height, scaled.serial) == (width, height, "7")
    assert len(warnings) == 1
    assert f"1280x960, its pictures are {width}x{height}" in warnings[0]


@pytest.mark.parametrize(("width", "height"), [(1280, 720), (960, 1280), (640, 640)])
def test_a_cut_or_turned_picture_is_refused_with_both_sizes(width: int, height: int) -> None:
    with pytest.raises(CameraError, match=f"for 1280x960, its pictures are {width}x{height}; calibrate at"):
        fit_to_size(LABEL, width, height)


FACTORY = CameraModel(1280, 960, np.array([[1003.0, 0, 648], [0, 993, 471], [0, 0, 1]]), CALIBRATED.distortion)


def test_the_factory_s_intrinsics_serve_where_there_is_no_file() -> None:
    label, warnings = known_or_factory("cam0", None, FACTORY, "7")
    assert (label.intrinsics_from, label.serial, warnings) == ("factory", "7", ())
    assert label.matrix[0][0] == 1003.0


def test_a_file_near_the_factory_s_intrinsics_is_taken_without_a_word() -> None:
    label, warnings = known_or_factory("cam0", LABEL, FACTORY, "7")
    assert (label.intrinsics_from, warnings) == ("calibration", ())
    assert label.matrix == LABEL.matrix


def test_a_file_far_from_the_factory_s_intrinsics_is_told_in_px_at_the_edge() -> None:
    far = CameraModel(1280, 960, np.array([[1100.0, 0, 648], [0, 1090, 471], [0, 0, 1]]), FACTORY.distortion)
    label, warnings = known_or_factory("cam0", LABEL, far, "7")
    assert label.intrinsics_from == "calibration"
    (told,) = warnings
    # By hand, without the distortion: the corner's ray (-648/1100, -471/1090) lies at (61, 42) in the file's camera.
    assert "differ by 76 px at the picture's edge" in told


def test_a_calibration_of_another_camera_is_told() -> None:
    for warnings in (
        known_or_factory("cam0", LABEL, FACTORY, "8")[1],
        known_or_guessed("cam0", LABEL, 1280, 960, "8")[1],
    ):
        assert warnings == ("the calibration of cam0 is of the camera 7, this one is 8: calibrate it",)
