from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from common.geometry import CameraModel
from common.markers import Family, family
from common.messages import DetectedMarker
from services.label.edge_pattern import pattern_of
from services.label.refine import KIND, Refined, refine
from tests.support.rendered_marker import MATRIX, SIZE, Seen, drawing, looking_at, render

TAG: Family = family("apriltag_36h11", Path())
LENS = np.array([0.08, -0.15, 0.0005, -0.0005, 0.05])


def coarse(seen: Seen, marker: int, rng: np.random.Generator, off_px: float = 0.6) -> DetectedMarker:
    """A detector's corners: each off by about ``off_px``."""
    corners = seen.corners + rng.normal(0, off_px / np.sqrt(2), (4, 2))
    return DetectedMarker(id=marker, corners=tuple(map(tuple, corners.tolist())), kind="subpix")


def errors(distance_mm: float, count: int = 5, camera: CameraModel | None = None, **how: object) -> np.ndarray:
    """Corner errors (count, 4) px of refined corners over random views; every one must converge."""
    rng = np.random.default_rng(int(distance_mm))
    found = []
    for _ in range(count):
        marker = int(rng.integers(587))
        seen = render(drawing("DICT_APRILTAG_36h11", marker), 50, looking_at(rng, distance_mm), rng, **how)
        refined = refine(seen.grey, coarse(seen, marker, rng), TAG, camera)
        assert refined.converged
        assert refined.kind == KIND
        found.append(np.linalg.norm(np.array(refined.corners) - seen.corners, axis=1))
    return np.array(found)


@pytest.mark.parametrize("distance_mm", [400, 800, 1400])
def test_corners_of_a_50_mm_tag_are_right_to_a_fiftieth_of_a_pixel(distance_mm: float) -> None:
    assert errors(distance_mm).mean() < 0.02


@pytest.mark.parametrize(("blur_px", "limit"), [(0.0, 0.02), (1.5, 0.05), (2.5, 0.15)])
def test_blur_is_found_out(blur_px: float, limit: float) -> None:
    assert errors(600, blur_px=blur_px).mean() < limit


def test_a_gamma_does_not_shrink_the_black_square() -> None:
    rng = np.random.default_rng(3)
    sizes = []
    for _ in range(5):
        seen = render(drawing("DICT_APRILTAG_36h11", 8), 50, looking_at(rng, 450), rng, gamma=2.2)
        refined = refine(seen.grey, coarse(seen, 8, rng), TAG)
        assert refined.converged
        area = cv2.contourArea(np.array(refined.corners, dtype=np.float32))
        sizes.append(np.sqrt(area / cv2.contourArea(seen.corners.astype(np.float32))) - 1)
    # Unmodelled, the square of some 100 px is 0.6 px too small: 6e-3.
    assert abs(np.mean(sizes)) < 3e-4


def test_lens_distortion_is_taken_into_account() -> None:
    camera = CameraModel(*SIZE, MATRIX, LENS)
    with_lens = errors(380, 2, camera, distortion=LENS)
    without = errors(380, 2, distortion=LENS)
    assert with_lens.mean() < 0.02
    assert without.mean() > 2 * with_lens.mean()


def test_half_a_pixel_is_not_lost() -> None:
    rng = np.random.default_rng(5)
    off = []
    for _ in range(10):
        seen = render(drawing("DICT_APRILTAG_36h11", 4), 50, looking_at(rng, 500), rng, noise=0)
        refined = refine(seen.grey, coarse(seen, 4, rng), TAG)
        off.append((np.array(refined.corners) - seen.corners).mean(axis=0))
    assert np.abs(np.mean(off, axis=0)).max() < 0.003


def test_other_families_are_refined_as_well() -> None:
    rng = np.random.default_rng(6)
    for cv2_name, name in (("DICT_4X4_50", "4x4_50"), ("DICT_6X6_250", "6x6_250"), ("DICT_APRILTAG_16h5", "tag16h5")):
        seen = render(drawing(cv2_name, 5), 50, looking_at(rng, 500), rng)
        refined = refine(seen.grey, coarse(seen, 5, rng), family(name, Path()))
        assert refined.converged, name
        assert np.abs(np.array(refined.corners) - seen.corners).max() < 0.05, name


def test_grey_and_colour_give_the_same() -> None:
    rng = np.random.default_rng(7)
    seen = render(drawing("DICT_APRILTAG_36h11", 4), 50, looking_at(rng, 600), rng)
    marker = coarse(seen, 4, rng)
    colour = cv2.cvtColor(seen.grey, cv2.COLOR_GRAY2BGR)
    assert np.allclose(refine(seen.grey, marker, TAG).corners, refine(colour, marker, TAG).corners, atol=1e-6)


def test_corners_two_pixels_off_are_caught() -> None:
    rng = np.random.default_rng(8)
    seen = render(drawing("DICT_APRILTAG_36h11", 4), 50, looking_at(rng, 600, 30), rng)
    away = seen.corners + np.array([[1.5, -1.2], [-1.4, 1.3], [1.6, 1.1], [-1.5, -1.5]])
    marker = DetectedMarker(id=4, corners=tuple(map(tuple, away.tolist())), kind="contour")
    refined = refine(seen.grey, marker, TAG)
    assert refined.converged
    assert np.abs(np.array(refined.corners) - seen.corners).max() < 0.05
    assert refined.shift_px == pytest.approx(np.linalg.norm(away - seen.corners, axis=1).max(), abs=0.06)


def test_a_finger_over_a_part_does_not_pull_the_corners() -> None:
    rng = np.random.default_rng(9)
    seen = render(drawing("DICT_APRILTAG_36h11", 4), 50, looking_at(rng, 400, 20), rng)
    middle = seen.corners.mean(axis=0).astype(int)
    grey = cv2.circle(seen.grey.copy(), (int(middle[0]) + 12, int(middle[1])), 14, 120, -1)
    refined = refine(grey, coarse(seen, 4, rng), TAG)
    assert refined.converged
    assert np.abs(np.array(refined.corners) - seen.corners).max() < 0.15


def corner_under_a_thumb(seen: Seen, corner: int, inwards: float, radius: int) -> np.ndarray:
    at = seen.corners[corner] + inwards * (seen.corners.mean(axis=0) - seen.corners[corner])
    return cv2.circle(seen.grey.copy(), (round(at[0]), round(at[1])), radius, 150, -1)


def test_a_covered_corner_is_found_where_the_rest_of_the_pattern_puts_it() -> None:
    """A thumb bends the lines that a detector draws along two sides: its corner is off by pixels, two others stay."""
    rng = np.random.default_rng(21)
    for corner in range(4):
        seen = render(drawing("DICT_APRILTAG_36h11", 4), 50, looking_at(rng, 600, 30), rng)
        led_astray = seen.corners.copy()
        led_astray[corner] += 0.08 * (seen.corners.mean(axis=0) - seen.corners[corner]) * [1.6, 0.8]
        led_astray[corner - 1] += [0.7, -0.6]
        marker = DetectedMarker(id=4, corners=tuple(map(tuple, led_astray.tolist())), kind="edges")
        refined = refine(corner_under_a_thumb(seen, corner, 0.05, 9), marker, TAG)
        assert refined.converged
        off = np.linalg.norm(np.array(refined.corners) - seen.corners, axis=1)
        assert off.max() < 0.15
        assert refined.shift_px > 1.0


def test_corners_that_the_picture_does_not_bear_out_are_doubted() -> None:
    rng = np.random.default_rng(22)
    seen = render(drawing("DICT_APRILTAG_36h11", 4), 50, looking_at(rng, 400, 30), rng)
    led_astray = seen.corners + np.array([[0, 0], [0, 0], [14.0, 11.0], [0, 0]])
    marker = DetectedMarker(id=4, corners=tuple(map(tuple, led_astray.tolist())), kind="edges")
    refined = refine(corner_under_a_thumb(seen, 2, 0.4, 40), marker, TAG)
    assert refused(refined, marker)
    assert refined.doubt_px is not None
    assert refined.doubt_px[2] > 5.0


@pytest.mark.parametrize("side_px", [12.0, 14.0, 18.0])
def test_small_markers_are_refined_as_well(side_px: float) -> None:
    distance = 50 * MATRIX[0, 0] / side_px
    rng = np.random.default_rng(int(side_px))
    better, converged = [], 0
    for marker in range(12):
        seen = render(drawing("DICT_APRILTAG_36h11", marker), 50, looking_at(rng, distance, 20), rng)
        found = coarse(seen, marker, rng, 0.25)
        refined = refine(seen.grey, found, TAG)
        converged += refined.converged
        off = [np.linalg.norm(np.array(corners) - seen.corners, axis=1) for corners in (found.corners, refined.corners)]
        better.append(off[0].mean() - off[1].mean())
    assert converged >= 8
    assert np.mean(better) > 0.05


def half_shaded(seen: Seen, angle: float, through: np.ndarray, light: float) -> np.ndarray:
    """A shadow's edge, 2 px soft, through a point (px): beyond it there is so much of the light."""
    y, x = np.mgrid[: seen.grey.shape[0], : seen.grey.shape[1]]
    along = (x - through[0]) * np.cos(angle) + (y - through[1]) * np.sin(angle)
    return np.rint(seen.grey * (1 - (1 - light) * np.clip(along / 2 + 0.5, 0, 1))).astype(np.uint8)


@pytest.mark.parametrize("light", [0.25, 0.5, 0.75])
def test_a_shadows_edge_across_a_marker_costs_little(light: float) -> None:
    rng = np.random.default_rng(31)
    off, bars = [], []
    for marker in range(8):
        seen = render(drawing("DICT_APRILTAG_36h11", marker), 50, looking_at(rng, 600, 30), rng)
        through = seen.corners.mean(axis=0) + rng.uniform(-0.15, 0.15, 2) * np.ptp(seen.corners, axis=0)
        grey = half_shaded(seen, rng.uniform(0, 2 * np.pi), through, light)
        refined = refine(grey, coarse(seen, marker, rng), TAG)
        assert refined.converged
        assert refined.covariance is not None
        off.append(np.linalg.norm(np.array(refined.corners) - seen.corners, axis=1))
        bars.append(np.sqrt(np.diag(refined.covariance).reshape(4, 2).sum(axis=1)))
    assert np.mean(off) < 0.04
    assert np.max(off) < 0.2
    assert np.mean(np.array(off) < 2 * np.array(bars)) > 0.85


def test_something_before_half_of_a_marker_is_no_shadow() -> None:
    rng = np.random.default_rng(32)
    seen = render(drawing("DICT_APRILTAG_36h11", 4), 50, looking_at(rng, 600, 30), rng)
    middle = int(seen.corners[:, 0].mean())
    for grey_value in (40, 150):
        covered = seen.grey.copy()
        covered[:, middle:] = grey_value
        marker = coarse(seen, 4, rng)
        assert refused(refine(covered, marker, TAG), marker)


def refused(refined: Refined, marker: DetectedMarker) -> bool:
    return not refined.converged and refined.corners == marker.corners and refined.kind == marker.kind


def test_what_does_not_fit_is_refused_and_the_coarse_corners_stay() -> None:
    rng = np.random.default_rng(10)
    seen = render(drawing("DICT_APRILTAG_36h11", 4), 50, looking_at(rng, 600, 30), rng)
    marker = coarse(seen, 4, rng)
    other = marker.model_copy(update={"id": 5})
    assert refused(refine(seen.grey, other, TAG), other), "another id's pattern"
    assert refused(refine(255 - seen.grey, marker, TAG), marker), "an inverted picture"
    assert refused(refine(np.full_like(seen.grey, 128), marker, TAG), marker), "no contrast at all"
    noise = rng.integers(0, 256, seen.grey.shape, dtype=np.uint8)
    assert refused(refine(noise, marker, TAG), marker), "noise"
    turned = marker.model_copy(update={"corners": marker.corners[2:] + marker.corners[:2]})
    assert refused(refine(seen.grey, turned, TAG), turned), "corners in another order"


def test_a_marker_that_is_mostly_outside_the_picture_is_refused() -> None:
    rng = np.random.default_rng(11)
    seen = render(drawing("DICT_APRILTAG_36h11", 4), 50, looking_at(rng, 600, 30), rng)
    marker = coarse(seen, 4, rng)
    cut = int(seen.corners[:, 0].mean())
    assert refused(refine(np.ascontiguousarray(seen.grey[:, :cut]), marker, TAG), marker)


@pytest.mark.parametrize(
    "corners",
    [
        ((10.0, 10.0), (10.0, 10.0), (10.0, 10.0), (10.0, 10.0)),
        ((10.0, 10.0), (14.0, 10.0), (14.0, 14.0), (10.0, 14.0)),
        ((10.0, 10.0), (60.0, 10.0), (110.0, 10.0), (160.0, 10.0)),
        ((float("nan"), 10.0), (60.0, 10.0), (60.0, 60.0), (10.0, 60.0)),
        ((-900.0, -900.0), (-800.0, -900.0), (-800.0, -800.0), (-900.0, -800.0)),
        ((1e9, 1e9), (2e9, 1e9), (2e9, 2e9), (1e9, 2e9)),
    ],
    ids=["point", "tiny", "line", "nan", "outside", "far"],
)
def test_nonsense_corners_are_refused(corners: tuple[tuple[float, float], ...]) -> None:
    picture = np.random.default_rng(12).integers(0, 256, (480, 640), dtype=np.uint8)
    marker = DetectedMarker.model_construct(id=4, corners=corners, kind="contour")
    refined = refine(picture, marker, TAG)
    assert not refined.converged
    assert refined.kind == "contour"


def test_an_unknown_id_is_a_callers_mistake() -> None:
    marker = DetectedMarker(id=587, corners=((10, 10), (60, 10), (60, 60), (10, 60)), kind="contour")
    with pytest.raises(ValueError, match="0 to 586"):
        refine(np.zeros((100, 100), np.uint8), marker, TAG)


@pytest.mark.parametrize("width", [0.08, 0.3])
def test_the_patterns_slopes_are_its_derivatives(width: float) -> None:
    pattern = pattern_of(TAG.bitmap(7))
    rng = np.random.default_rng(13)
    u, v = rng.uniform(-0.5, 8.5, (2, 400)).astype(np.float32)
    blur = np.full(400, width, dtype=np.float32)
    here, step = pattern.at(u, v, blur, blur), np.float32(2e-3)
    along_u = (pattern.at(u + step, v, blur, blur).value - pattern.at(u - step, v, blur, blur).value) / (2 * step)
    along_v = (pattern.at(u, v + step, blur, blur).value - pattern.at(u, v - step, blur, blur).value) / (2 * step)
    wider, sharper = blur * np.exp(step), blur * np.exp(-step)
    by_blur = (pattern.at(u, v, wider, wider).value - pattern.at(u, v, sharper, sharper).value) / (2 * step)
    assert np.abs(here.by_u - along_u).max() < 0.02
    assert np.abs(here.by_v - along_v).max() < 0.02
    assert np.abs(here.by_log_blur - by_blur).max() < 0.01


def test_a_sharp_pattern_hardly_feels_any_but_the_nearest_edges() -> None:
    pattern = pattern_of(TAG.bitmap(7))
    u, v = np.random.default_rng(13).uniform(-0.5, 8.5, (2, 400)).astype(np.float32)
    blur, skew = np.full(400, 0.149, dtype=np.float32), np.full(400, 0.3, dtype=np.float32)
    near = pattern.at(u, v, blur, blur, skew)
    blur[-1] = 1.0  # one point that feels them all, and all are asked
    exact = pattern.at(u, v, blur, blur, skew)
    for name, most in (("value", 1e-3), ("by_u", 0.03), ("by_v", 0.03), ("by_log_blur", 0.01)):
        assert np.abs(getattr(near, name) - getattr(exact, name))[:-1].max() < most


def test_the_pattern_without_blur_is_the_bitmap() -> None:
    bitmap = TAG.bitmap(7)
    middles = np.arange(8, dtype=np.float32) + 0.5
    u, v = (grid.ravel() for grid in np.meshgrid(middles, middles))
    sharp = np.full(64, 0.01, dtype=np.float32)
    assert np.allclose(pattern_of(bitmap).at(u, v, sharp, sharp).value.reshape(8, 8), bitmap, atol=1e-5)


def test_rows_and_columns_that_dont_meet_squarely_cost_nothing() -> None:
    """Where a tilted marker's edges meet at a slant, blurs along rows and columns are correlated."""
    u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(1, 7, 25), np.linspace(1, 7, 25)))
    slope = np.array([[1.0, 0.6], [0.0, 1.0]])  # cells per px
    blur = 0.4
    offsets = np.random.default_rng(14).normal(0, blur, (4000, 2)) @ slope.T
    pattern = pattern_of(TAG.bitmap(7))
    sharp = np.full(len(u), 1e-3)
    sampled = np.mean(
        [pattern.at(*(np.float32(a) for a in (u + du, v + dv, sharp, sharp))).value for du, dv in offsets], axis=0
    )
    widths = np.linalg.norm(slope, axis=1) * blur
    skew = slope[0] @ slope[1] / np.prod(np.linalg.norm(slope, axis=1))
    across, down = (np.full(len(u), width, dtype=np.float32) for width in widths)
    model = pattern.at(np.float32(u), np.float32(v), across, down, np.full(len(u), skew, dtype=np.float32)).value
    assert np.abs(model - sampled).max() < 0.04
    without = pattern.at(np.float32(u), np.float32(v), across, down).value
    assert np.abs(without - sampled).max() > 0.06


def test_the_covariance_predicts_the_scatter_of_the_corners() -> None:
    rng = np.random.default_rng(15)
    squares = []
    for _ in range(24):
        seen = render(drawing("DICT_APRILTAG_36h11", 4), 50, looking_at(rng, rng.uniform(600, 1400), 65), rng)
        refined = refine(seen.grey, coarse(seen, 4, rng), TAG)
        if refined.covariance is not None:
            error = (np.array(refined.corners) - seen.corners).ravel()
            squares.append(error @ np.linalg.solve(refined.covariance, error) / 8)
    assert len(squares) >= 20
    assert 0.3 < np.median(squares) < 1.5
    assert np.mean(np.array(squares) < 3.0) > 0.9


def bars(count: int, distance_mm: float, smear_px: int = 0, margin: float | None = None, **how: float) -> np.ndarray:
    """Corner errors of markers (count,), rms px, and in units of what the covariance promises."""
    rng, found = np.random.default_rng(7), []
    for _ in range(count):
        marker = int(rng.integers(587))
        seen = render(drawing("DICT_APRILTAG_36h11", marker), 50, looking_at(rng, distance_mm), rng, **how)
        grey = seen.grey if not smear_px else cv2.blur(seen.grey, (smear_px, 1))
        refined = refine(grey, coarse(seen, marker, rng), TAG, margin=margin)
        if not refined.converged:
            continue
        assert refined.covariance is not None
        off = (np.array(refined.corners) - seen.corners).ravel()
        found.append((np.sqrt(np.mean(off**2)), np.sqrt(off @ np.linalg.solve(refined.covariance, off) / 8)))
    assert len(found) > 0.8 * count
    return np.sqrt(np.mean(np.square(found), axis=0))


def test_what_lies_beyond_a_narrow_border_does_not_pull_the_corners() -> None:
    """Four fifths of a cell, as many people cut their markers: 3 px here, over which blur carries the wall's grey."""
    known, unknown = (bars(12, 1500, margin=margin, border_cells=0.8, blur_px=1.0) for margin in (0.1, None))
    assert known[0] < 0.6 * unknown[0]
    assert known[1] < 1.6


def test_the_covariance_feels_what_motion_blur_does_to_the_corners() -> None:
    px, ratio = bars(12, 1000, smear_px=7, noise=1.0)
    assert px > 0.1  # it hurts
    assert ratio < 2.6  # 2.75 if pixels' misfits were independent
