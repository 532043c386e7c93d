"""The camera model against cv2 inside the picture, and against common sense outside of it."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.geometry import CameraModel
from common.labels import CameraLabel


def camera(width, height, focal, centre, distortion, model="pinhole") -> CameraModel:
    matrix = np.array([[focal[0], 0, centre[0]], [0, focal[1], centre[1]], [0, 0, 1.0]])
    return CameraModel(width, height, matrix, np.array(distortion, dtype=float), model)


PLAIN = camera(1280, 720, (921.6, 921.6), (639.5, 359.5), [0, 0, 0, 0, 0])
MILD = camera(1280, 720, (921.6, 920.0), (630, 365), [0.08, -0.15, 0.0005, -0.0005, 0.05])
WIDE = camera(1280, 720, (600, 600), (639.5, 359.5), [-0.28, 0.09, 0.001, -0.001, -0.01])
BARREL = camera(1280, 720, (921.6, 921.6), (639.5, 359.5), [-0.5, 0, 0, 0, 0])
TWO_TAGS = camera(1920, 1080, (2142.5, 2142.7), (993.7, 543.0), [0.514, -6.091, 0.001, 0.001, 19.87])
RATIONAL = camera(640, 480, (500, 500), (320, 240), [0.2, -0.1, 0.001, 0.0, 0.01, 0.25, -0.05, 0.02])
FISHEYE = camera(1280, 720, (400, 400), (639.5, 359.5), [-0.02, 0.005, -0.001, 0.0002], "fisheye")
NARROW_FISHEYE = camera(1280, 720, (900, 900), (639.5, 359.5), [0.05, -0.02, 0.0, 0.0], "fisheye")
ALL = {
    "plain": PLAIN,
    "mild": MILD,
    "wide": WIDE,
    "barrel": BARREL,
    "two_tags": TWO_TAGS,
    "rational": RATIONAL,
    "fisheye": FISHEYE,
    "narrow_fisheye": NARROW_FISHEYE,
}
cameras = st.sampled_from(sorted(ALL)).map(ALL.__getitem__)


def by_cv2(model: CameraModel, points) -> np.ndarray:
    xyz = np.array(points, dtype=float).reshape(-1, 1, 3)
    zero = np.zeros(3)
    if model.model == "fisheye":
        return cv2.fisheye.projectPoints(xyz, zero, zero, model.matrix, model.distortion)[0].reshape(-1, 2)
    return cv2.projectPoints(xyz, zero, zero, model.matrix, model.distortion)[0].reshape(-1, 2)


def grid_of_pixels(model: CameraModel) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(0, model.width - 1, 23), np.linspace(0, model.height - 1, 17))
    return np.column_stack([x.ravel(), y.ravel()])


def test_pinhole_by_hand():
    pixels, front = PLAIN.project([[100, -50, 1000], [0, 0, 500]])
    np.testing.assert_allclose(pixels, [[639.5 + 92.16, 359.5 - 46.08], [639.5, 359.5]])
    assert front.all()


@pytest.mark.parametrize("name", ALL)
def test_as_cv2_inside_the_picture(name):
    model = ALL[name]
    rays = model.normalise(grid_of_pixels(model))
    rays = rays[np.isfinite(rays).all(axis=1)]
    assert len(rays) > 150
    points = np.column_stack([rays, np.ones(len(rays))]) * 700
    np.testing.assert_allclose(model.project(points)[0], by_cv2(model, points), atol=1e-6)


@pytest.mark.parametrize("name", ALL)
def test_pixel_to_ray_and_back(name):
    model = ALL[name]
    pixels = grid_of_pixels(model)
    rays = model.normalise(pixels)
    known = np.isfinite(rays).all(axis=1)
    again, _ = model.project(np.column_stack([rays, np.ones(len(rays))])[known] * 321)
    np.testing.assert_allclose(again, pixels[known], atol=0.01)


@pytest.mark.parametrize("name", ["plain", "mild", "wide", "two_tags", "rational", "narrow_fisheye"])
def test_every_pixel_of_a_usual_camera_has_a_ray(name):
    assert np.isfinite(ALL[name].normalise(grid_of_pixels(ALL[name]))).all()


def test_pixels_that_no_ray_reaches_are_nan():
    # r (1 - r²/2) rises up to r = sqrt(2/3) and reaches 0.544; the picture's corner lies at 0.797
    radius = np.hypot(*(np.array([1279, 719]) - [639.5, 359.5])) / 921.6
    assert radius > 0.79
    assert np.isnan(BARREL.normalise([[1279, 719]])).all()
    assert np.isfinite(BARREL.normalise([[639.5 + 0.5 * 921.6, 359.5]])).all()
    # the corner of this fisheye looks sideways by more than 90 degrees
    assert np.isnan(FISHEYE.normalise([[0, 0]])).all()


@pytest.mark.parametrize("name", ALL)
def test_what_lies_far_outside_is_projected_far_outside(name):
    """Without care a radial polynomial folds back: a point far to the side would appear inside the picture."""
    model = ALL[name]
    for degrees in range(0, 360, 15):
        angle = np.radians(degrees)
        radii = np.tan(np.radians(np.linspace(0.5, 89.5, 200)))
        points = np.column_stack([radii * np.cos(angle), radii * np.sin(angle), np.ones_like(radii)]) * 1000
        pixels, front = model.project(points)
        assert front.all()
        assert np.isfinite(pixels).all()
        out = np.hypot(*(pixels - model.matrix[:2, 2]).T)
        assert (np.diff(out) > -1e-6).all(), degrees


def test_two_tags_keeps_to_cv2_a_little_beyond_its_picture():
    rays = TWO_TAGS.normalise([[0, 0], [1919, 1079]]) * 1.02
    points = np.column_stack([rays, np.ones(2)])
    np.testing.assert_allclose(TWO_TAGS.project(points)[0], by_cv2(TWO_TAGS, points), atol=1e-6)


def test_a_high_order_term_does_not_fling_points_away():
    far = TWO_TAGS.project([[1.5, 0, 1.0]])[0][0]
    assert by_cv2(TWO_TAGS, [[1.5, 0, 1.0]])[0, 0] > 100_000
    assert 2500 < far[0] < 6000


def test_behind_the_camera_is_no_projection():
    pixels, front = MILD.project([[0, 0, -100], [0, 0, 0], [10, 10, 0.5], [np.nan, 0, 100], [0, 0, np.nan]])
    assert not front[[0, 1, 2, 4]].any()
    assert np.isnan(pixels[[0, 1, 2, 4]]).all()


def test_no_points_are_fine():
    pixels, front = MILD.project(np.zeros((0, 3)))
    assert pixels.shape == (0, 2)
    assert front.shape == (0,)
    assert MILD.normalise(np.zeros((0, 2))).shape == (0, 2)
    assert FISHEYE.normalise(np.zeros((0, 2))).shape == (0, 2)


def test_contains_is_the_pictures_area():
    inside = PLAIN.contains([[-0.5, -0.5], [1279.4, 719.4], [1279.5, 10], [10, 719.5], [-0.6, 5], [np.nan, 5]])
    assert inside.tolist() == [True, True, False, False, False, False]


def test_from_label():
    label = CameraLabel(
        name="cam0",
        width=1280,
        height=720,
        matrix=((900.0, 0.0, 640.0), (0.0, 900.0, 360.0), (0.0, 0.0, 1.0)),
        distortion=(0.1, -0.05, 0.0, 0.0, 0.0),
    )
    model = CameraModel.from_label(label)
    np.testing.assert_array_equal(model.matrix, label.matrix)
    assert model.distortion.tolist() == list(label.distortion)
    assert (model.width, model.height, model.model) == (1280, 720, "pinhole")


def test_guess_has_the_field_of_view_that_was_asked_for():
    model = CameraModel.guess(640, 480, field_of_view_deg=90)
    edge = np.tan(np.radians(45))
    pixels, _ = model.project([[-edge, 0, 1], [edge, 0, 1]])
    np.testing.assert_allclose(pixels[:, 0], [-0.5, 639.5])


@settings(max_examples=200)
@given(
    model=cameras,
    x=st.floats(-1e6, 1e6),
    y=st.floats(-1e6, 1e6),
    z=st.floats(-1e6, 1e6),
)
def test_a_projection_is_finite_or_nan_and_says_which(model, x, y, z):
    pixels, front = model.project([[x, y, z]])
    assert front[0] == (z >= 1.0)
    assert np.isfinite(pixels).all() == front[0]


@settings(max_examples=200)
@given(model=cameras, u=st.floats(0, 1), v=st.floats(0, 1), depth=st.floats(10, 5000))
def test_round_trip_anywhere_in_the_picture(model, u, v, depth):
    pixel = np.array([u * (model.width - 1), v * (model.height - 1)])
    ray = model.normalise(pixel)[0]
    if np.isfinite(ray).all():
        again, _ = model.project([ray[0] * depth, ray[1] * depth, depth])
        np.testing.assert_allclose(again[0], pixel, atol=0.01)


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
def test_points_that_are_a_part_of_a_larger_array_have_the_same_rays(model: Literal["pinhole", "fisheye"]) -> None:
    matrix = np.array([[500.0, 0, 322], [0, 500.0, 236], [0, 0, 1]])
    camera = CameraModel(640, 480, matrix, np.array([0.02, -0.01, 0, 0]), model=model)
    pixels = np.random.default_rng(1).uniform(50, 400, (20, 2))
    assert np.allclose(camera.normalise(pixels[1::2]), camera.normalise(pixels)[1::2])
