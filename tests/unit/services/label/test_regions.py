"""What is erased: looked at from the pictures, not from the polygons' own arithmetic."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.models import PoseConfig
from common.geometry import Box, BoxSide, MarkerOnSide, Pose
from common.labels import LeftOut
from common.markers import family
from common.messages import DetectedMarker
from services.label.inpaint import Crop, erase, mask_of, regions
from services.label.labelling import Labeller
from tests.support.april_tags import april_tags
from tests.unit.services.label.truth import BOX, CAMERA, FISHEYE, MARKER_CORNERS, camera, looking_at, project, seen

FAMILY = family("apriltag_36h11", Path())
WHOLE = Crop(0, 0, 1280, 720)
PLACES = {marker.id: (side, marker) for side, marker in BOX.markers()}


def labelled(markers, boxes=(BOX,), model=CAMERA):
    return Labeller(boxes, FAMILY, PoseConfig()).label_once(markers, model)


def erased(markers, boxes=(BOX,), model=CAMERA, margin=0.15):
    result = labelled(markers, boxes, model)
    return regions(result.objects, result.left_out, boxes, model, margin)


def area(polygons) -> np.ndarray:
    return mask_of(polygons, WHOLE) > 0


def border_corners(id_: int, widen_mm: float) -> np.ndarray:
    """The hand-written corners, moved outwards along both edges of the marker."""
    corners = np.array(MARKER_CORNERS[id_], float)
    centre = corners.mean(axis=0)
    half = np.abs(corners - centre).max()
    return centre + (corners - centre) * (half + widen_mm) / half


def border_outline(id_: int, widen_mm: float) -> np.ndarray:
    """The same with points along its edges, which a lens bends."""
    corners = border_corners(id_, widen_mm)
    following = np.roll(corners, -1, axis=0)
    return np.concatenate([np.linspace(a, b, 40, endpoint=False) for a, b in zip(corners, following, strict=True)])


def drawn(corners_px) -> np.ndarray:
    picture = np.zeros((720, 1280), np.uint8)
    cv2.fillPoly(picture, [np.round(np.array(corners_px) * 16).astype(np.int32)], 255, cv2.LINE_8, 4)
    return picture > 0


@pytest.mark.parametrize("model", [CAMERA, FISHEYE, camera((-0.2, 0.05, 0, 0, 0))], ids=["lens", "fisheye", "barrel"])
@pytest.mark.parametrize("view", [(35, 25, 700), (60, 10, 500), (20, 60, 1500)])
def test_border_and_three_pixels_are_covered(model, view):
    pose = looking_at(*view)
    facing = [0, 1, 2]
    mask = area(erased(seen(*facing, pose=pose, model=model), model=model))
    for id_ in facing:
        border = drawn(project(border_outline(id_, PLACES[id_][1].border_mm), pose, model))
        wanted = cv2.dilate(border.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))) > 0
        assert border.any()
        assert not (wanted & ~mask).any(), id_


def test_the_margin_grows_with_the_marker():
    pose = looking_at(35, 25, 500)
    mask = area(erased(seen(0, 1, 2, pose=pose), margin=0.3))
    for id_ in (0, 1, 2):
        _, marker = PLACES[id_]
        assert not (drawn(project(border_outline(id_, marker.border_mm + 0.27 * marker.size_mm), pose)) & ~mask).any()


def test_no_more_is_erased_than_needed():
    pose = looking_at(35, 25, 500)
    mask = area(erased(seen(0, 1, 2, pose=pose)))
    allowed = np.zeros_like(mask)
    for id_ in (0, 1, 2):
        allowed |= drawn(project(border_outline(id_, 10 + 0.15 * 50 + 5), pose))
    assert not (mask & ~allowed).any()


def test_undetected_markers_of_a_posed_object_are_erased_but_not_those_turned_away():
    polygons = erased(seen(0, pose=looking_at(35, 25, 900)))
    assert {(p.marker, p.because) for p in polygons} == {(0, "detected"), (0, "pose"), (1, "pose"), (2, "pose")}


def test_unknown_markers_are_erased_with_a_border():
    corners = ((100.0, 100.0), (140.0, 100.0), (140.0, 140.0), (100.0, 140.0))
    polygons = erased([DetectedMarker(id=77, corners=corners, kind="subpix")])
    assert [(p.marker, p.because) for p in polygons] == [(77, "detected")]
    mask = area(polygons)
    assert mask[92:149, 92:149].all()  # 20 % border
    assert not mask[:84].any()
    assert not mask[157:].any()


def test_all_copies_of_an_id_seen_twice_are_erased():
    here, there = looking_at(35, 25, 900), looking_at(10, 10, 1200, (350, -150))
    copies = [*seen(0, pose=here), *seen(0, pose=there)]
    mask = area(erased([*copies, *seen(1, 2, pose=here)]))
    undecided = area(erased(copies))
    for pose in (here, there):
        black = drawn(project(MARKER_CORNERS[0], pose))
        assert not (black & ~mask).any()
        assert not (black & ~undecided).any()


def test_a_marker_half_outside_is_erased_up_to_the_edge():
    pose = looking_at(-35, 25, 900)
    centre = pose.apply(np.mean(MARKER_CORNERS[0], axis=0))[0]
    # marker 0 lies on the picture's left edge, marker 3 on the right side is seen
    shifted = Pose(pose.rotation, pose.translation - [centre[0] + centre[2] * 639.5 / 921.6, 0, 0])
    polygons = [p for p in erased(seen(3, pose=shifted)) if p.marker == 0]
    assert polygons
    visible = drawn(project(border_outline(0, 10), shifted))
    assert visible.any()
    assert not (visible & ~area(polygons)).any()
    for polygon in polygons:
        corners = np.array(polygon.polygon)
        assert corners[:, 0].min() >= -1.0
        assert corners[:, 0].max() <= 1280
        assert corners[:, 1].min() >= -1.0
        assert corners[:, 1].max() <= 720


def test_a_marker_hidden_by_another_object_is_left_alone():
    behind = looking_at(0, 0, 1500)
    screen = Box(
        "screen", "plate", (500.0, 400.0, 4.0), (BoxSide("front", "front", (MarkerOnSide(9, 50, 10, (180, 0, 0)),)),)
    )
    before = looking_at(0, 0, 700)
    marker_9 = project([(155, -2, 25), (205, -2, 25), (205, -2, -25), (155, -2, -25)], before)
    nine = DetectedMarker(id=9, corners=tuple(map(tuple, marker_9.tolist())), kind="photometric")
    box = labelled(seen(0, pose=behind)).objects
    plate = labelled([nine], (screen,)).objects
    both = regions([*box, *plate], [], (BOX, screen), CAMERA)
    assert {p.marker for p in both if p.because == "pose"} == {9}
    # were the screen away, marker 0 would be erased from its pose
    assert {p.marker for p in regions(box, [], (BOX,), CAMERA) if p.because == "pose"} == {0}


def test_of_two_possible_poses_both_are_erased():
    ambiguous = next(
        result
        for seed in range(50)
        if (result := labelled(seen(0, pose=looking_at(12, 8, 1500), noise=0.3, kind="subpix", seed=seed))).objects
        and result.objects[0].quality.ambiguous
    )
    label = ambiguous.objects[0]
    assert label.quality.alternative_pose is not None
    alone = label.model_copy(update={"quality": label.quality.model_copy(update={"alternative_pose": None})})
    both = regions(ambiguous.objects, [], (BOX,), CAMERA)
    one = regions([alone], [], (BOX,), CAMERA)
    assert set(one) < set(both)


LABEL = labelled(seen(0, pose=looking_at(35, 25, 900))).objects[0]


@settings(max_examples=100, deadline=None)
@given(
    rvec=st.tuples(*[st.floats(-3.1, 3.1)] * 3),
    tvec=st.tuples(st.floats(-800, 800), st.floats(-800, 800), st.floats(-200, 2500)),
    corners=st.tuples(*[st.tuples(st.floats(-300, 1600), st.floats(-300, 1000))] * 4),
)
def test_polygons_are_finite_and_in_the_picture_whatever_comes(rvec, tvec, corners):
    label = LABEL.model_copy(update={"pose": Pose.from_rvec(rvec, tvec).label()})
    odd = LeftOut(marker=5, reason="unknown_marker", corners=corners)
    for polygon in regions([label], [odd], (BOX,), CAMERA):
        points = np.array(polygon.polygon)
        assert len(points) >= 3
        assert np.isfinite(points).all()
        assert (points >= -1).all()
        assert (points <= (1280, 720)).all()


# --- the paper's failure: white border feeding the fill ---------------------------------------------------

GREY = 90


def plain_scene(pose: Pose, ids=(0, 1, 2), model=CAMERA, seed: int = 0) -> np.ndarray:
    """A plain grey picture with the box's stickers (marker and white border) on it, blurred and noisy."""
    picture = np.full((720, 1280, 3), GREY, np.uint8)
    scale = 20
    for id_ in ids:
        _, marker = PLACES[id_]
        cells = FAMILY.bitmap(id_) * 255
        size = round(marker.size_mm * scale / 2)
        black = cv2.resize(cells, (size, size), interpolation=cv2.INTER_NEAREST)
        pad = round(marker.border_mm * scale / 2)
        sticker = cv2.copyMakeBorder(black, pad, pad, pad, pad, cv2.BORDER_CONSTANT, value=255)
        edge = sticker.shape[0] - 0.5
        source = np.array([[-0.5, -0.5], [edge, -0.5], [edge, edge], [-0.5, edge]], np.float32)
        target = project(border_corners(id_, marker.border_mm), pose, model).astype(np.float32)
        to_picture = cv2.getPerspectiveTransform(source, target)
        warped = cv2.warpPerspective(sticker, to_picture, (1280, 720), flags=cv2.INTER_AREA)
        there = cv2.warpPerspective(np.full_like(sticker, 255), to_picture, (1280, 720)) / 255.0
        picture = (picture * (1 - there[..., None]) + warped[..., None] * there[..., None]).astype(np.uint8)
    picture = cv2.GaussianBlur(picture, (0, 0), 0.8).astype(np.float64)
    return np.clip(picture + np.random.default_rng(seed).normal(0, 1.0, picture.shape), 0, 255).astype(np.uint8)


def look_for_markers(*pictures: np.ndarray) -> list[set[int]]:
    """By detectors that aren't ours."""
    greys = [cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) for picture in pictures]
    by_cv2 = [cv2.aruco.ArucoDetector(FAMILY.dictionary).detectMarkers(grey)[1] for grey in greys]
    return [
        {*tags, *([] if ids is None else ids.ravel().tolist())}
        for tags, ids in zip(april_tags(greys), by_cv2, strict=True)
    ]


@pytest.mark.parametrize("method", ["telea", "ns"])
@pytest.mark.parametrize("view", [(35, 25, 500), (50, 15, 900), (20, 45, 1400)])
def test_nothing_of_the_markers_is_left(view, method):
    pose = looking_at(*view)
    picture = plain_scene(pose)
    before = picture.copy()
    polygons = erased(seen(0, pose=pose, noise=0.05))  # two of the three went undetected
    erase(picture, polygons, method)
    mask = area(polygons)
    np.testing.assert_array_equal(picture[~mask], before[~mask])
    there, left = look_for_markers(before, picture)
    assert len(there) >= 2
    assert left == set()
    # no bright spot, no dark one, where the border was 165 brighter and the black 90 darker
    assert np.abs(picture.astype(int) - GREY).max() <= 20
    assert np.abs(cv2.GaussianBlur(picture, (0, 0), 2.0).astype(int) - GREY).max() <= 12


def test_a_mask_of_just_the_marker_would_leave_a_bright_spot():
    """The paper's finding; it shows that the test above can fail."""
    pose = looking_at(35, 25, 500)
    picture = plain_scene(pose, (0,))
    black = project(MARKER_CORNERS[0], pose)
    polygon = erased(seen(0, pose=pose))[0].model_copy(update={"polygon": tuple(map(tuple, black.tolist()))})
    erase(picture, [polygon])
    assert picture.max() > 200
