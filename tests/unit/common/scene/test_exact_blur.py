"""The exact quality's pixels against the closed form: a Gaussian lens before pixels that collect what falls on them."""

from __future__ import annotations

from math import erf, sqrt

import numpy as np
import pytest

from common.geometry import MarkerOnSide, Pose
from common.markers import Family
from common.scene import Scene, SceneCamera
from tests.unit.common.scene.conftest import camera, plate

SIZE_MM, DEPTH_MM, FOCAL = 80.0, 400.0, 600.0
BLACK, WHITE = 22.0, 236.0
UPRIGHT = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])


def collected(from_edge: float, sigma: float) -> float:
    """The share of white on a pixel whose centre is so many px on the white side of a straight blurred edge."""
    steps = (np.arange(200) + 0.5) / 200 - 0.5
    return float(np.mean([0.5 * (1 + erf((from_edge + step) / (sigma * sqrt(2)))) for step in steps]))


@pytest.mark.parametrize("sigma", [0.6, 1.2])
def test_an_edge_has_the_profile_that_a_lens_gives_it(tags: Family, sigma: float) -> None:
    scene = Scene([plate(MarkerOnSide(0, SIZE_MM, 16.0))], tags, clutter=0.0, light=0.0)
    exact = SceneCamera(scene, camera(np.zeros(5)), quality="exact")
    for shift_px in (0.0, 0.3, 0.5, 0.85):
        # The plate's front is 2 mm before its centre.
        pose = Pose(UPRIGHT, np.array([shift_px * DEPTH_MM / FOCAL, 0.0, DEPTH_MM + 2.0]))
        row = exact.render(0, {"plate": pose}, noise=0, blur_px=sigma, depth=False).bgr[240, :, 1].astype(float)
        edge = 319.5 + shift_px - SIZE_MM / 2 * FOCAL / DEPTH_MM
        near = range(int(edge) - 4, int(edge) + 6)
        expected = [BLACK + (WHITE - BLACK) * collected(edge - column, sigma) for column in near]
        assert np.abs(row[near.start : near.stop] - expected).max() < 1.5
