"""The fill that knows the plane: on pictures of planes whose every pixel is known."""

from __future__ import annotations

from typing import get_args

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.models import InpaintConfig
from common.labels import ErasedPolygon
from services.label.grain import grain
from services.label.inpaint import METHODS, Crop, erase, mask_of
from services.label.surfaces import Region, Surface, surface_of_corners

WHOLE = Crop(0, 0, 400, 300)
BOARD = (120, 160, 200)
QUAD = np.array([(150, 100), (240, 112), (232, 196), (146, 180)], dtype=float)
"""Of a square from (-1, 1) to (1, -1) on the plane."""


def plane_picture(draw=lambda board: None, noise: float = 0.0) -> np.ndarray:
    """A board of 8 by 8 units seen at an angle; ``draw`` prints on it, 50 px to a unit, (0, 0) in its middle."""
    board = np.full((400, 400, 3), BOARD, np.uint8)
    draw(board)
    to_pixel = surface_of_corners(tuple(map(tuple, QUAD))).to_pixel
    to_plane = np.array([[1 / 50, 0, -4], [0, -1 / 50, 4], [0, 0, 1]])
    seen = cv2.warpPerspective(board, to_pixel @ to_plane, (400, 300), borderMode=cv2.BORDER_REPLICATE)
    grain = np.random.default_rng(3).normal(0, noise, seen.shape) if noise else 0
    return np.clip(np.rint(seen + grain), 0, 255).astype(np.uint8)


def region(surface: Surface | None = None, quad: np.ndarray = QUAD) -> Region:
    polygon = ErasedPolygon(marker=0, because="detected", polygon=tuple(map(tuple, quad)))
    return Region(polygon, surface or surface_of_corners(tuple(map(tuple, QUAD))))


def with_marker(picture: np.ndarray) -> np.ndarray:
    out = picture.copy()
    cv2.fillPoly(out, [np.rint((QUAD - QUAD.mean(axis=0)) * 0.94 + QUAD.mean(axis=0)).astype(int)], (0, 0, 0))
    return out


def hole() -> np.ndarray:
    return mask_of([region().polygon], WHOLE) > 0


def worst(filled: np.ndarray, truth: np.ndarray) -> int:
    return int(np.abs(filled.astype(int) - truth)[hole()].max())


def erased(picture: np.ndarray, method: str, *regions: Region) -> np.ndarray:
    out = with_marker(picture)
    erase(out, regions or [region()], method)
    return out


def test_the_methods_are_those_of_the_rig_file():
    assert get_args(InpaintConfig.model_fields["method"].annotation) == METHODS


def test_a_uniform_board_comes_back():
    picture = plane_picture()
    assert worst(erased(picture, "plane"), picture) <= 1


def test_a_gradient_of_light_comes_back():
    light = np.linspace(0.7, 1.2, 400)[None, :, None] * np.linspace(1.1, 0.8, 300)[:, None, None]
    picture = np.rint(plane_picture() * light).clip(0, 255).astype(np.uint8)
    assert worst(erased(picture, "smooth"), picture) <= 4


@pytest.mark.parametrize("axis", [0, 1])
def test_a_stripe_along_an_axis_of_the_side_goes_on(axis):
    def stripe(board):
        where = [slice(None), slice(None)]
        where[axis] = slice(195, 215)
        board[tuple(where)] = (60, 80, 90)

    picture = plane_picture(stripe)
    away = {name: np.abs(erased(picture, name).astype(float) - picture)[hole()].mean() for name in ("smooth", "telea")}
    assert away["smooth"] < 4
    assert away["smooth"] < away["telea"] / 2


def test_lettering_beside_the_marker_is_not_smeared_into_it():
    def letters(board):
        cv2.putText(board, "BOX", (250, 215), cv2.FONT_HERSHEY_DUPLEX, 1.4, (20, 20, 20), 5)

    picture = plane_picture(letters)
    cleared = plane_picture()
    clear = hole() & (np.abs(picture.astype(int) - cleared).max(axis=2) == 0)
    away = np.abs(erased(picture, "smooth").astype(int) - cleared)[clear]
    assert away.max() <= 12
    assert away.mean() < 2


def test_only_the_marker_s_own_side_feeds_the_fill():
    picture = plane_picture()
    beyond = 250
    picture[:, beyond:] = (0, 0, 255)
    outline = np.array([(-100, -100), (beyond - 0.5, -100), (beyond - 0.5, 400), (-100, 400)], dtype=float)
    known = surface_of_corners(tuple(map(tuple, QUAD)))
    wide = QUAD + np.array([(0, 0), (22, 0), (22, 0), (0, 0)])
    surface = Surface(known.to_pixel, outline, distance_mm=500.0)
    filled = picture.copy()
    erase(filled, [region(surface, wide)], "plane")
    inside = mask_of([region(surface, wide).polygon], WHOLE) > 0
    columns = np.arange(400)[None, :]
    near = np.abs(filled.astype(int) - picture).max(axis=2)
    assert near[inside & (columns < beyond - 2)].max() <= 2
    assert near[inside & (columns > beyond + 1)].max() <= 2


def test_the_fill_is_as_grainy_as_the_picture():
    picture = plane_picture(noise=4.0)
    plane, smooth = (erased(picture, name).astype(float)[hole()].std(axis=0) for name in ("plane", "smooth"))
    truth = picture.astype(float)[hole()].std(axis=0)
    assert (np.abs(plane / truth - 1) < 0.15).all()
    assert (smooth < 0.3 * truth).all()


def test_grain_is_as_strong_where_its_blocks_meet_as_within_them():
    noise = np.random.default_rng(3).normal(128, 4.0, (240, 240, 3))
    picture = np.clip(np.rint(noise), 0, 255).astype(np.uint8)
    texture = grain(picture, np.ones(picture.shape[:2], dtype=bool), (600, 500), seed=0)
    assert texture.shape == (500, 600, 3)
    for size in ((1, 1), (8, 9), (13, 24)):
        assert grain(picture, np.ones(picture.shape[:2], dtype=bool), size, seed=0).shape == (size[1], size[0], 3)
    spread = texture.std()
    for axis in (0, 1):
        # In blocks' edges, which repeat every so many pixels, no row or column stands out.
        by_place = [np.take(texture, np.arange(start, 500, 12), axis).std() for start in range(12)]
        assert max(abs(np.array(by_place) / spread - 1)) < 0.03


def test_the_same_every_time_and_nothing_outside_is_touched():
    picture = plane_picture(noise=4.0)
    first, second = erased(picture, "plane"), erased(picture, "plane")
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(first[~hole()], with_marker(picture)[~hole()])


def test_one_fill_does_not_feed_another():
    picture = plane_picture(noise=2.0)
    right = QUAD + np.array([96.0, 0.0])
    regions = [region(), region(surface_of_corners(tuple(map(tuple, right))), right)]
    cv2.fillPoly(picture, [np.rint(right).astype(int)], (255, 255, 255))
    filled = erased(picture, "plane", *regions)
    both = mask_of([item.polygon for item in regions], WHOLE) > 0
    assert np.abs(filled[both].astype(float) - BOARD).max() < 20


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.floats(-60, 460), st.floats(-60, 360)), min_size=3, max_size=6), st.booleans())
def test_any_polygon_can_be_erased(corners, flat):
    picture = plane_picture(noise=2.0)
    quad = tuple(corners[:4]) if len(corners) > 3 else None
    surface = None if quad is None or flat else surface_of_corners(quad)
    polygon = ErasedPolygon(marker=0, because="detected", polygon=tuple(corners))
    before = picture.copy()
    erase(picture, [Region(polygon, surface)], "plane")
    outside = mask_of([polygon], WHOLE) == 0
    np.testing.assert_array_equal(picture[outside], before[outside])
