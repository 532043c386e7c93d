from __future__ import annotations

from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.models import PoseConfig
from common.geometry import Box, BoxSide, CameraModel, MarkerOnSide, Pose
from common.markers import family
from common.messages import DetectedMarker
from services.label.labelling import Labeller
from tests.support.rendered_marker import MATRIX, SIZE, drawing, render
from tests.support.rendered_marker import looking_at as view_of
from tests.unit.services.label.test_regions import plain_scene
from tests.unit.services.label.truth import (
    BOX,
    BOX_CORNERS,
    CAMERA,
    MARKER_CORNERS,
    detected,
    looking_at,
    project,
    seen,
)

FAMILY = family("apriltag_36h11", Path())
POSE = looking_at(35, 25, 900)
TWIN = Box("box-2", "box", BOX.size_mm, (BoxSide("front", "front", (MarkerOnSide(10, 50, 10),)),))
FRAME_NS = 33_000_000


def labeller(*boxes: Box) -> Labeller:
    return Labeller(boxes or (BOX,), FAMILY, PoseConfig())


def reasons(result) -> Counter[tuple[int, str]]:
    return Counter((entry.marker, entry.reason) for entry in result.left_out)


def test_a_whole_label():
    result = labeller().label(seen(0, 1, 2, pose=POSE), CAMERA, "cam0", 0)
    (label,) = result.objects
    assert (label.id, label.name, label.type, label.source, label.pose_source) == (
        0,
        "box-1",
        "box",
        "markers",
        "measured",
    )
    np.testing.assert_allclose(Pose.from_label(label.pose).matrix, POSE.matrix, atol=1e-3)
    np.testing.assert_allclose([(c.x, c.y) for c in label.corners], project(BOX_CORNERS, POSE), atol=0.01)
    assert label.distance_mm == pytest.approx(900, abs=0.01)
    assert label.window == label.window_unclipped
    assert label.quality.markers == 3
    assert not label.quality.ambiguous
    assert label.quality.reprojection_error_px < 0.001
    assert result.left_out == ()


def test_sides_have_class_face_distances_and_polygon_and_come_by_facing():
    (label,) = labeller().label(seen(0, 1, 2, pose=POSE), CAMERA, "cam0", 0).objects
    assert {side.class_name: (side.face, side.marker) for side in label.sides} == {
        "front": ("front", 0),
        "left": ("left", 1),
        "lid": ("top", 2),
    }
    angles = [side.viewing_angle_deg for side in label.sides]
    assert angles == sorted(angles)
    for side in label.sides:
        centre = POSE.apply(np.mean(MARKER_CORNERS[side.marker], axis=0))[0]
        assert side.distance_mm == pytest.approx(np.linalg.norm(centre), abs=0.01)
        assert side.distance_joint_mm == pytest.approx(np.linalg.norm(centre), abs=0.01)
        assert side.corners_kind == "photometric"
        assert side.residual_px < 0.001
    front = next(side for side in label.sides if side.class_name == "front")
    np.testing.assert_allclose(front.polygon, project(BOX_CORNERS[:4], POSE), atol=0.01)


def test_objects_are_numbered_in_rig_order():
    shifted = looking_at(0, 20, 1200, (300, 0))
    front = [(-25, -100, 25), (25, -100, 25), (25, -100, -25), (-25, -100, -25)]
    twin = detected(10, project(front, shifted))
    result = labeller(BOX, TWIN).label([twin, *seen(0, 2, pose=POSE)], CAMERA, "cam0", 0)
    assert [(label.id, label.name, label.type) for label in result.objects] == [
        (0, "box-1", "box"),
        (1, "box-2", "box"),
    ]
    alone = labeller(BOX, TWIN).label([twin], CAMERA, "cam0", 0)
    assert [(label.id, label.name) for label in alone.objects] == [(0, "box-2")]


def test_unknown_markers_are_left_out():
    result = labeller().label(
        [detected(77, [(1, 1), (9, 1), (9, 9), (1, 9)]), *seen(0, 1, 2, pose=POSE)], CAMERA, "c", 0
    )
    assert reasons(result) == {(77, "unknown_marker"): 1}
    assert len(result.objects) == 1


def test_markers_that_should_be_seen_are_named():
    result = labeller().label(seen(0, pose=POSE), CAMERA, "cam0", 0)
    assert reasons(result) == {(1, "not_detected"): 1, (2, "not_detected"): 1}  # right and back are turned away
    outside = looking_at(0, 25, 900, (0, -350))
    result = labeller().label(seen(0, pose=outside), CAMERA, "cam0", 0)
    assert project([np.mean(MARKER_CORNERS[2], axis=0)], outside)[0, 1] < 0
    assert reasons(result) == {}  # the lid's marker is out of the picture


def test_of_an_object_that_is_not_seen_every_marker_is_named():
    result = labeller(BOX, TWIN).label([], CAMERA, "cam0", 0)
    assert result.objects == ()
    assert reasons(result) == {(id_, "not_detected"): 1 for id_ in (0, 1, 2, 3, 4, 10)}


def test_a_bad_pose_is_no_object():
    result = labeller().label([detected(0, [(100, 100)] * 4)], CAMERA, "cam0", 0)
    assert result.objects == ()
    assert reasons(result)[0, "bad_pose"] == 1


def test_a_contradicting_marker_is_named_and_the_object_keeps_the_rest():
    zero, one, two = seen(0, 1, 2, pose=POSE)
    off = detected(1, np.add(one.corners, (50, 20)))
    result = labeller().label([zero, off, two], CAMERA, "cam0", 0)
    assert reasons(result) == {(1, "contradicts"): 1}
    assert {side.marker for side in result.objects[0].sides} == {0, 2}
    both = labeller().label([zero, off], CAMERA, "cam0", 0)
    assert both.objects == ()
    assert reasons(both)[0, "contradicts"] == reasons(both)[1, "contradicts"] == 1


def test_a_duplicate_is_left_out_then_decided_by_the_last_pose():
    (zero,), (copy,) = seen(0, pose=POSE), seen(0, pose=looking_at(-20, 10, 1300, (-350, 60)))
    fresh = labeller().label([zero, copy], CAMERA, "cam0", 0)
    assert fresh.objects == ()
    assert reasons(fresh)[0, "duplicate_marker"] == 2
    known = labeller()
    known.label([zero], CAMERA, "cam0", 0)
    result = known.label([copy, zero], CAMERA, "cam0", FRAME_NS)
    np.testing.assert_allclose(Pose.from_label(result.objects[0].pose).matrix, POSE.matrix, atol=1e-3)
    assert [entry.corners for entry in result.left_out if entry.reason == "duplicate_marker"] == [copy.corners]
    # another camera knows nothing of it, nor does this one after half a second
    assert known.label([copy, zero], CAMERA, "cam1", FRAME_NS).objects == ()
    assert known.label([copy, zero], CAMERA, "cam0", 600_000_000 + FRAME_NS).objects == ()


def test_label_once_takes_what_is_known_from_outside_and_keeps_nothing():
    (zero,), (copy,) = seen(0, pose=POSE), seen(0, pose=looking_at(-20, 10, 1300, (-350, 60)))
    service, worker = labeller(), labeller()
    service.label([zero], CAMERA, "cam0", 0)
    around = service.around("cam0", FRAME_NS)
    assert set(around.previous) == {"box-1"}
    assert len(worker.label_once([copy, zero], CAMERA, around=around).objects) == 1
    assert worker.label_once([copy, zero], CAMERA).objects == ()
    assert worker.around("cam0", FRAME_NS).previous == {}
    service.forget("cam0")
    assert service.around("cam0", FRAME_NS).previous == {}


def test_with_the_picture_corners_are_refined():
    picture = plain_scene(POSE)
    coarse = seen(0, 1, 2, pose=POSE, noise=0.5, kind="contour", seed=4)
    without = labeller().label(coarse, CAMERA, "cam0", 0).objects[0]
    for shown in (picture, cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)):
        refined = labeller().label(coarse, CAMERA, "cam0", 0, shown).objects[0]
        assert [side.corners_kind for side in refined.sides].count("photometric") >= 2
        assert Pose.from_label(refined.pose).angle_to(POSE) < Pose.from_label(without.pose).angle_to(POSE)
        assert abs(refined.distance_mm - 900) < abs(without.distance_mm - 900)


def test_a_picture_without_the_marker_keeps_the_coarse_corners():
    grey = np.full((720, 1280), 90, np.uint8)
    (label,) = labeller().label(seen(0, 2, pose=POSE, kind="subpix"), CAMERA, "cam0", 0, grey).objects
    assert {side.corners_kind for side in label.sides} == {"subpix"}


@settings(max_examples=150, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([0, 1, 2, 3, 10, 77]),
            st.tuples(*[st.tuples(st.floats(-50, 1350), st.floats(-50, 770))] * 4),
        ),
        max_size=6,
    ),
    st.booleans(),
)
def test_every_detection_is_accounted_for_whatever_it_is(quads, with_truth):
    """No detected marker vanishes: each is a side or left out with its reason (one that is reported twice, once)."""
    markers = [DetectedMarker(id=id_, corners=corners, kind="subpix") for id_, corners in quads]
    markers += seen(0, 1, pose=POSE) if with_truth else []
    result = labeller(BOX, TWIN).label(markers, CAMERA, "cam0", 0)
    sides = Counter(side.marker for label in result.objects for side in label.sides)
    assert not sides or max(sides.values()) == 1
    told = {*((side.marker, side.marker_corners) for label in result.objects for side in label.sides)}
    told |= {(entry.marker, entry.corners) for entry in result.left_out}
    for id_ in {marker.id for marker in markers}:
        assert any(marker.id == id_ and (id_, marker.corners) in told for marker in markers)
    for label in result.objects:
        assert label.model_validate_json(label.model_dump_json(by_alias=True))
        numbers = [*label.pose.tvec_mm, *label.pose.rvec, label.distance_mm, label.quality.reprojection_error_px]
        assert np.isfinite(numbers).all()


# --- a photograph with a distance that was measured by hand ------------------------------------------------


def test_the_photo_of_marker_403_is_as_far_away_as_it_was_measured(testdata):
    picture = cv2.imread(str(testdata("ubiquity/403.jpg")))
    lens = CameraModel(
        1280,
        960,
        np.array([[1006.126285753055, 0, 655.8639244150409], [0, 1004.015433012594, 490.6140221242933], [0, 0, 1]]),
        np.array([0.1349735087283542, -0.2335869827451621, 0.0006697030315075139, 0.004846737465872353, 0.0]),
    )
    numbers = family("5x5_1000", Path())
    corners, ids, _ = cv2.aruco.ArucoDetector(numbers.dictionary).detectMarkers(
        cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    )
    found = [detected(int(i), c.reshape(4, 2), "contour") for i, c in zip(ids.ravel(), corners, strict=True)]
    plate = Box("plate", "plate", (200.0, 200.0, 2.0), (BoxSide("front", "front", (MarkerOnSide(403, 145, 20),)),))
    for shown in (None, picture):
        result = Labeller([plate], numbers, PoseConfig()).label(found, lens, "cam0", 0, shown)
        (side,) = result.objects[0].sides
        assert side.distance_mm == pytest.approx(779.4, rel=0.01)
        assert side.distance_joint_mm == pytest.approx(side.distance_mm, rel=0.001)
    assert side.corners_kind == "photometric"


def test_a_contradicting_marker_is_listed_with_how_far_off_it_is():
    zero, one, two = seen(0, 1, 2, pose=POSE)
    moved = detected(1, np.add(one.corners, (45, -30)))
    result = labeller().label([zero, moved, two], CAMERA, "cam0", 0)
    (entry,) = [item for item in result.left_out if item.reason == "contradicts"]
    assert entry.marker == 1
    assert entry.residual_px == pytest.approx(np.hypot(45, 30), abs=1)


def test_what_is_in_view_but_has_no_pose_is_missing_in_a_stream_but_not_alone():
    broken = detected(10, [(100, 100)] * 4)
    service = labeller(BOX, TWIN)
    result = service.label([broken, *seen(0, pose=POSE)], CAMERA, "cam0", 0)
    assert [(item.object, item.reason, item.seen_ms_ago) for item in result.missing] == [("box-2", "bad_pose", None)]
    assert labeller(BOX, TWIN).label_once([broken, *seen(0, pose=POSE)], CAMERA).missing == ()


def test_a_lone_marker_whose_corner_is_covered_is_never_wrong_and_sure():
    """A thumb over a corner leads the detector's lines astray; what the picture doesn't bear out widens the bar."""
    random, right = np.random.default_rng(31), []
    camera = CameraModel(*SIZE, MATRIX, np.zeros(5))
    lone = Box("lone", "box", BOX.size_mm, (BoxSide("front", "front", (MarkerOnSide(4, 50, 10),)),))
    on_box = lone.marker_pose(*lone.markers()[0])
    for corner, (inwards, radius) in enumerate([(0.02, 8), (0.1, 14), (0.3, 30), (0.4, 40)]):
        placed = view_of(random, 450, 35)
        picture = render(drawing("DICT_APRILTAG_36h11", 4), 50, placed, random)
        towards = picture.corners.mean(axis=0) - picture.corners[corner]
        at = picture.corners[corner] + inwards * towards
        grey = cv2.circle(picture.grey.copy(), (round(at[0]), round(at[1])), radius, 150, -1)
        astray = picture.corners.copy()
        astray[corner] += 0.15 * towards
        marker = DetectedMarker(id=4, corners=tuple(map(tuple, astray.tolist())), kind="edges")
        (label,) = Labeller((lone,), FAMILY, PoseConfig()).label_once([marker], camera, grey).objects
        off = np.degrees(Pose.from_label(label.pose).angle_to(Pose(*placed).after(on_box.inverse())))
        right.append(off < 0.5)
        assert label.quality.ambiguous or off < 3 * label.quality.uncertainty.rotation_deg
    assert sum(right) >= 2
