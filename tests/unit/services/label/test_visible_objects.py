from __future__ import annotations

import numpy as np

from common.geometry import Box, BoxSide, MarkerOnSide
from services.label.visible_objects import SeenMarker, doubted, left_out, not_detected, sort_markers
from tests.unit.services.label.truth import BOX, detected

TWIN = Box("box-2", "box", (400.0, 300.0, 200.0), (BoxSide("front", "front", (MarkerOnSide(10, 50, 10),)),))


def square(id_: int, x: float, y: float = 100.0, size: float = 40.0):
    return detected(id_, [(x, y), (x + size, y), (x + size, y + size), (x, y + size)], "subpix")


def ids(markers) -> list[int]:
    return [marker.marker.id for marker in markers]


def test_several_sides_of_one_object_are_joined():
    found = sort_markers([square(1, 300), square(0, 100), square(2, 500)], [BOX, TWIN])
    assert [visible.box.name for visible in found.objects] == ["box-1"]
    assert ids(found.objects[0].markers) == [0, 1, 2]
    assert [box.name for box in found.unseen] == ["box-2"]


def test_objects_of_one_type_stay_apart_and_come_in_rig_order():
    found = sort_markers([square(10, 300), square(0, 100)], [BOX, TWIN])
    assert [(visible.box.name, ids(visible.markers)) for visible in found.objects] == [("box-1", [0]), ("box-2", [10])]
    assert found.unseen == ()


def test_unknown_ids_are_kept_apart_each_of_them():
    found = sort_markers([square(77, 100), square(0, 300), square(77, 500), square(78, 700)], [BOX])
    assert [marker.id for marker in found.unknown] == [77, 77, 78]
    assert ids(found.objects[0].markers) == [0]


def test_an_id_seen_twice_is_not_guessed():
    found = sort_markers([square(0, 100), square(1, 300), square(0, 500)], [BOX])
    assert ids(found.objects[0].markers) == [1]
    assert [ids(group) for group in found.objects[0].copies] == [[0, 0]]


def test_one_marker_reported_twice_at_one_place_is_one_marker():
    found = sort_markers([square(0, 100), square(0, 102, 101, 37)], [BOX])
    assert ids(found.objects[0].markers) == [0]
    assert found.objects[0].copies == ()


def test_nothing_seen():
    found = sort_markers([], [BOX, TWIN])
    assert found.objects == ()
    assert found.unseen == (BOX, TWIN)


def test_corner_noise_follows_from_how_corners_were_found():
    side, marker = BOX.markers()[0]
    noise = [
        SeenMarker(side, marker, detected(0, [(0, 0)] * 4, kind)).noise_px
        for kind in ("photometric", "apriltag", "subpix", "contour", "never heard of")
    ]
    assert noise == [0.05, 0.1, 0.3, 0.7, 0.7]


def test_entries_of_what_was_left_out():
    side, marker = BOX.markers()[0]
    seen = SeenMarker(side, marker, square(0, 100))
    entry = left_out(seen, "duplicate_marker", BOX)
    assert (entry.marker, entry.reason, entry.object) == (0, "duplicate_marker", "box-1")
    assert entry.corners == seen.seen.corners
    assert not_detected(marker, BOX).corners is None


def test_a_doubted_corner_counts_for_less_than_the_others() -> None:
    side, marker = BOX.markers()[0]
    seen = SeenMarker(side, marker, detected(0, [(0, 0)] * 4, "edges"))
    covariance = doubted(seen, (0.0, 0.0, 10.0, 0.1)).covariance
    sigma = np.sqrt(np.diag(covariance)).reshape(4, 2)
    np.testing.assert_allclose(sigma[:2], seen.noise_px)
    np.testing.assert_allclose(np.hypot(*sigma[2]), 10.0, rtol=0.01)
    assert sigma[3].max() < 0.15
