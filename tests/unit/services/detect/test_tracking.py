"""Tracking gives what a full search of each frame would give."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import zip_longest
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.messages import DetectedMarker
from services.detect.markers import MarkerDetector, open_detector
from services.detect.tracking import SEARCH_EVERY, Tracker
from tests.support.rendered_marker import drawing

HERE = Path()
SIZE = (480, 360)


class Searches:
    """The default detector, counting its full searches."""

    def __init__(self) -> None:
        self.own = open_detector("apriltag_36h11", HERE)
        self.family = self.own.family
        self.follow = self.own.follow
        self.count = 0

    def detect(self, grey: np.ndarray) -> list[DetectedMarker]:
        self.count += 1
        return self.own.detect(grey)


def frame(markers: dict[int, np.ndarray] | list[tuple[int, np.ndarray]], seed: int = 0) -> np.ndarray:
    """Markers with these corners (4, 2) on a grey wall, with noise."""
    grey = np.full((SIZE[1] * 4, SIZE[0] * 4), 120, np.uint8)
    for marker, corners in markers.items() if isinstance(markers, dict) else markers:
        cells = np.pad(drawing("DICT_APRILTAG_36h11", marker) * 190 + 35, 1, constant_values=225).astype(np.uint8)
        big = cv2.resize(cells, None, fx=16, fy=16, interpolation=cv2.INTER_NEAREST)
        source = np.array([[1, 1], [9, 1], [9, 9], [1, 9]], dtype=np.float32) * 16 - 0.5
        warp = cv2.getPerspectiveTransform(source, ((corners + 0.5) * 4 - 0.5).astype(np.float32))
        cv2.warpPerspective(big, warp, grey.shape[::-1], dst=grey, borderMode=cv2.BORDER_TRANSPARENT)
    small = cv2.GaussianBlur(cv2.resize(grey, SIZE, interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    noise = np.random.default_rng(seed).normal(0, 3, small.shape)
    return np.clip(np.rint(small + noise), 0, 255).astype(np.uint8)


def square(x: float, y: float, side: float, turn_deg: float = 0.0) -> np.ndarray:
    angle = np.radians(turn_deg)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * side @ turn + (x, y)


def moving(frames: int) -> Iterator[dict[int, np.ndarray]]:
    """Two markers on curves, one turning, one coming nearer; equal ids are in it too."""
    for t in range(frames):
        yield {
            3: square(110 + 5 * t, 120 + 20 * np.sin(t / 6), 60, 3 * t),
            8: square(360 - 4 * t, 250 - 2 * t, 30 + t, -2 * t),
        }


def drifting(frames: int) -> Iterator[dict[int, np.ndarray]]:
    """Two markers that move so slowly that none is lost."""
    for t in range(frames):
        yield {3: square(110 + t, 120, 60), 8: square(360 - t, 250, 50)}


def assert_alike(one: list[DetectedMarker], other: list[DetectedMarker], within: float) -> None:
    one, other = (sorted(these, key=lambda m: (m.id, m.corners)) for these in (one, other))
    assert [m.id for m in one] == [m.id for m in other]
    for mine, its in zip(one, other, strict=True):
        assert np.abs(np.array(mine.corners) - np.array(its.corners)).max() < within


def test_a_moving_sequence_is_tracked_as_if_searched() -> None:
    detector = Searches()
    tracker = Tracker(detector)
    for number, markers in enumerate(moving(30)):
        grey = frame(markers, number)
        tracked = tracker.detect(grey)
        assert_alike(tracked, detector.own.detect(grey), 0.35)
        assert sorted(m.id for m in tracked) == [3, 8]
    # The first frame after each search has no velocity yet where a marker is new: that may cost one search.
    assert detector.count <= 30 // SEARCH_EVERY + 2


def test_a_marker_that_enters_is_found_within_five_frames() -> None:
    tracker = Tracker(open_detector("apriltag_36h11", HERE))
    still = {3: square(120, 120, 60)}
    for entered in range(1, SEARCH_EVERY + 1):
        tracker.reset()
        seen = []
        for number in range(entered + SEARCH_EVERY):
            markers = still if number < entered else {**still, 8: square(330, 220, 50)}
            seen.append([m.id for m in tracker.detect(frame(markers, number))])
        assert sorted(seen[-1]) == [3, 8]


def test_searching_later_finds_what_enters_for_the_frames_after_and_keeps_pace() -> None:
    detector = Searches()
    tracker = Tracker(detector)
    owed = 0
    for number, markers in enumerate(drifting(20)):
        before, entering = detector.count, {} if number < 9 else {11: square(60, 300, 50)}
        grey = frame({**markers, **entering}, number)
        found = tracker.detect(grey, later=True)
        assert {3, 8} <= {m.id for m in found}
        assert number == 0 or detector.count == before
        if tracker.owes_search:
            owed += 1
            assert list(tracker.look_around(grey)) == [], "this detector's search is one piece"
            assert not tracker.owes_search
        assert (11 in {m.id for m in found}) is (number > 12)
    assert owed == 4


def test_a_search_that_found_no_time_is_made_up_for_in_the_next_frame() -> None:
    detector = Searches()
    tracker = Tracker(detector)
    for number, markers in enumerate(drifting(SEARCH_EVERY + 2)):
        tracker.detect(frame(markers, number), later=True)
        assert tracker.owes_search is (number == SEARCH_EVERY - 1)
    assert detector.count == 2


def following(detector: MarkerDetector, still: dict[int, np.ndarray]) -> Tracker:
    """A tracker that is owed a search."""
    tracker = Tracker(detector)
    for number in range(SEARCH_EVERY):
        tracker.detect(frame(still, number), later=True)
    assert tracker.owes_search
    return tracker


def test_two_cameras_searches_take_turns_piece_by_piece() -> None:
    detector = open_detector("apriltag_36h11", HERE)
    stills = ({3: square(120, 120, 60)}, {8: square(330, 220, 50)})
    enter = ({11: square(330, 220, 40)}, {11: square(120, 120, 45)})
    trackers = [following(detector, still) for still in stills]
    both = [frame({**still, **more}, 9) for still, more in zip(stills, enter, strict=True)]
    turns = [tracker.look_around(grey) for tracker, grey in zip(trackers, both, strict=True)]
    assert len(list(zip_longest(*turns))) > 1
    for tracker, grey in zip(trackers, both, strict=True):
        searches = tracker.searches
        assert_alike(tracker.detect(grey), detector.detect(grey), 0.1)
        assert tracker.searches == searches, "what the search found is followed"


def test_a_search_that_is_broken_off_is_made_up_for_in_the_next_frame() -> None:
    still = {3: square(120, 120, 60)}
    tracker = following(open_detector("apriltag_36h11", HERE), still)
    searches = tracker.searches
    next(tracker.look_around(frame(still, 9)))
    assert (tracker.searches, tracker.owes_search) == (searches, True)
    assert {m.id for m in tracker.detect(frame({**still, 11: square(330, 220, 40)}, 10), later=True)} == {3, 11}
    assert tracker.searches == searches + 1


def test_a_marker_that_jumps_is_found_in_the_same_frame() -> None:
    detector = Searches()
    tracker = Tracker(detector)
    for x in (100, 103, 300, 120):
        (found,) = tracker.detect(frame({5: square(x, 150, 50)}))
        assert np.abs(np.mean(found.corners, axis=0) - (x, 150)).max() < 0.3
    assert detector.count == 3


def test_a_marker_that_turns_round_needs_no_search() -> None:
    detector = Searches()
    tracker = Tracker(detector)
    for number, x in enumerate((100, 105, 110, 115, 110)):  # off by more than a cell of 7.5 px from the prediction
        (found,) = tracker.detect(frame({5: square(x, 150, 60)}, number))
        assert np.abs(np.mean(found.corners, axis=0) - (x, 150)).max() < 0.3
    assert detector.count == 1


def test_a_marker_that_leaves_is_given_up_and_the_others_stay() -> None:
    detector = Searches()
    tracker = Tracker(detector)
    both = {3: square(120, 120, 60), 8: square(330, 220, 50)}
    assert len(tracker.detect(frame(both))) == 2
    for _ in range(3):
        assert [m.id for m in tracker.detect(frame({3: both[3]}))] == [3]
    assert detector.count == 2


def test_equal_ids_are_followed_each() -> None:
    tracker = Tracker(open_detector("apriltag_36h11", HERE))
    for t in range(6):
        corners = [square(100 + 3 * t, 120, 50), square(300 - 3 * t, 200, 50)]
        found = sorted(tracker.detect(frame([(7, corners[0]), (7, corners[1])])), key=lambda m: m.corners)
        assert [m.id for m in found] == [7, 7]
        assert all(np.abs(np.array(m.corners) - c).max() < 0.5 for m, c in zip(found, corners, strict=True))


def test_a_changed_resolution_begins_anew() -> None:
    tracker = Tracker(open_detector("apriltag_36h11", HERE))
    grey = frame({3: square(120, 120, 60)})
    tracker.detect(grey)
    half = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    (found,) = tracker.detect(half)
    assert np.abs(np.mean(found.corners, axis=0) - (59.75, 59.75)).max() < 0.3
    assert tracker.searches == 2


def test_an_empty_scene_and_a_detector_that_cannot_follow_are_searched_each_time() -> None:
    tracker = Tracker(open_detector("apriltag_36h11", HERE))
    for _ in range(3):
        assert tracker.detect(frame({})) == []
    assert tracker.searches == 3
    plain = Tracker(open_detector("apriltag_36h11", HERE, detector="opencv"))
    for _ in range(3):
        assert [m.id for m in plain.detect(frame({3: square(120, 120, 60)}))] == [3]
    assert plain.searches == 3


def test_a_real_video_is_tracked_as_if_searched(testdata: Callable[[str], Path]) -> None:
    video = cv2.VideoCapture(str(testdata("wpical/two_tags.mp4")))
    detector = Searches()
    tracker = Tracker(detector)
    for _ in range(24):
        more, bgr = video.read()
        assert more
        grey = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
        assert_alike(tracker.detect(grey), detector.own.detect(grey), 0.4)
    assert detector.count <= 24 // SEARCH_EVERY + 2


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_a_marker_is_not_followed_by_a_wrong_corner_order(turn: int) -> None:
    detector = open_detector("apriltag_36h11", HERE)
    (found,) = detector.detect(frame({3: square(120, 120, 60)}))
    corners = tuple(found.corners[(k + turn) % 4] for k in range(4))
    expected = found.model_copy(update={"corners": corners})
    followed = detector.follow(frame({3: square(121, 120, 60)}), [expected])
    assert (followed[0] is not None) == (turn == 0)
