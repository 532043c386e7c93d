"""An id at several places: the true one is found by the others or by the last pose, never guessed."""

from __future__ import annotations

from services.label.copies import settle_copies
from services.label.pose import CERTAIN, Prior
from services.label.visible_objects import sort_markers
from tests.unit.services.label.truth import BOX, CAMERA, detected, looking_at, seen

POSE = looking_at(35, 25, 900)
ELSEWHERE = looking_at(-20, 10, 1300, (-350, 60))


def settle(markers, prior: Prior | None = None):
    visible = sort_markers(markers, [BOX]).objects[0]
    used, doubtful = settle_copies(visible, CAMERA, 6.0, prior)
    return [m.seen for m in used], [m.seen for m in doubtful]


def test_the_objects_other_markers_decide():
    zero, one, two = seen(0, 1, 2, pose=POSE, noise=0.05)
    (copy,) = seen(0, pose=ELSEWHERE)
    for order in ([copy, zero, one, two], [zero, copy, one], [two, zero, copy]):
        used, doubtful = settle(order)
        assert zero in used
        assert copy not in used
        assert doubtful == [copy]


def test_without_help_nothing_is_guessed():
    (zero,), (copy,) = seen(0, pose=POSE), seen(0, pose=ELSEWHERE)
    used, doubtful = settle([zero, copy])
    assert used == []
    assert doubtful == [zero, copy]


def test_the_last_pose_decides():
    (zero,), (copy,) = seen(0, pose=POSE), seen(0, pose=ELSEWHERE)
    moved_on = looking_at(36, 25, 905, (6, -4))
    used, doubtful = settle([copy, zero], Prior(moved_on, CERTAIN))
    assert used == [zero]
    assert doubtful == [copy]


def test_a_last_pose_that_is_near_both_or_neither_decides_nothing():
    (zero,) = seen(0, pose=POSE)
    (near,) = seen(0, pose=looking_at(35, 25, 900, (35, 0)))
    (copy,) = seen(0, pose=ELSEWHERE)
    assert settle([zero, near], Prior(looking_at(35, 25, 900, (17, 0)), CERTAIN))[0] == []
    assert settle([zero, copy], Prior(looking_at(0, 0, 600, (300, 100)), CERTAIN))[0] == []
    assert settle([zero, copy], Prior(looking_at(0, 0, -600), CERTAIN))[0] == []


def test_two_whole_copies_of_an_object_are_not_guessed():
    first, second = seen(0, 1, pose=POSE), seen(0, 1, pose=looking_at(35, 25, 1500, (500, 0)))
    used, doubtful = settle([*first, *second])
    assert used == []
    assert len(doubtful) == 4


def test_copies_of_which_none_fits_are_all_left_out():
    one = seen(1, pose=POSE)
    copies = [*seen(0, pose=ELSEWHERE), *seen(0, pose=looking_at(10, 10, 1200, (300, -200)))]
    used, doubtful = settle([*one, *copies])
    assert used == one
    assert doubtful == copies


def test_many_copies_of_one_id():
    copies = [detected(0, [(x, 50), (x + 30, 50), (x + 30, 80), (x, 80)], "subpix") for x in range(100, 1200, 120)]
    used, doubtful = settle(copies)
    assert used == []
    assert len(doubtful) == len(copies)
