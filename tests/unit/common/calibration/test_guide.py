"""The guide, driven by views whose poses are known: what it takes, what it refuses, what it asks for, how it ends."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from common.boards import Board, standing
from common.calibration import Guidance, Guide, Miss, View, calibrate
from common.calibration.detect import BLURRED_PX
from common.calibration.guide import ENOUGH, HOLD_NS
from common.calibration.wishes import Wish
from common.geometry import Pose
from tests.unit.common.calibration.synthetic import Camera

BOARD = Board(kind="chessboard", columns=9, rows=6, square_mm=25)
FRAME_NS = 100_000_000
SHARES = {-1: 0.28, 0: 0.45, 1: 0.8}


class Operator:
    """Holds the board before a camera, one frame after another; nothing here knows how the guide decides."""

    def __init__(self, guide: Guide) -> None:
        self.guide = guide
        self.camera = Camera(noise_px=0.1)
        self.rng = np.random.default_rng(7)
        self.now = 0

    def view(self, pose: Pose, edge_px: float = 2.0) -> View:
        points = BOARD.points()
        corners, _ = self.camera.model.project(pose.apply(points.mm))
        corners += self.rng.normal(0, self.camera.noise_px, corners.shape)
        return View("a frame", (1280, 720), points.ids, points.mm, corners, edge_px, 20.0)

    def show(self, view: View | Miss) -> Guidance:
        self.now += FRAME_NS
        return self.guide.look(view, self.now)

    def hold(self, pose: Pose, edge_px: float = 2.0, frames: int = 6) -> list[Guidance]:
        """The board comes, and is held."""
        return [self.show(self.view(pose, edge_px)) for _ in range(frames)]

    def stand(self, wish: Wish | None = None, **keys: float | tuple[float, float]) -> Pose:
        if wish is not None:
            keys = {"place": wish.place, "tilt_deg": wish.tilt_deg, "towards_deg": wish.towards_deg}
            keys["share"] = SHARES[wish.nearer]
        return standing(BOARD.size_mm, self.camera.model, **keys)  # type: ignore[arg-type]


@pytest.fixture
def operator() -> Operator:
    return Operator(Guide(BOARD, (1280, 720)))


def test_who_does_what_the_guide_says_gets_a_good_calibration(operator: Operator) -> None:
    guide = operator.guide
    told = operator.show(Miss("", "no_board", "no board found"))
    assert told.phase == "looking"
    assert told.code == "no_board"
    taken = []
    while not guide.done and len(guide.views) < 30:
        assert told.wish is not None
        assert told.ghost is not None
        assert operator.camera.model.contains(told.ghost).all() or told.wish.nearer
        answers = operator.hold(operator.stand(told.wish))
        new = [answer.taken.name for answer in answers if answer.taken is not None]
        assert len(new) == 1, (told.words, [answer.words for answer in answers])
        taken += new
        told = answers[-1]
        if guide.wants_verdict:
            told = guide.judge(calibrate(guide.views, models=("5",)))
    assert told.phase == "done"
    assert told.verdict is not None
    assert told.verdict.level == "good"
    assert 10 <= len(guide.views) <= 20
    assert [view.name for view in guide.views] == taken
    assert len(set(taken)) == len(taken)
    assert operator.show(operator.view(operator.stand())).taken is None


def test_a_view_is_taken_once_and_only_after_the_board_was_still(operator: Operator) -> None:
    answers = operator.hold(operator.stand(), frames=12)
    taken = [number for number, answer in enumerate(answers) if answer.taken is not None]
    assert taken == [HOLD_NS // FRAME_NS]
    assert [answer.phase for answer in answers[: taken[0]]] == ["moving", "holding", "holding", "holding"]
    assert {answer.phase for answer in answers[taken[0] :]} == {"taken"}
    assert [answer.held for answer in answers[:5]] == pytest.approx([0, 0.25, 0.5, 0.75, 1.0])


def test_a_board_that_moves_is_never_taken(operator: Operator) -> None:
    for step in range(60):
        told = operator.show(operator.view(operator.stand(place=(0.3 + 0.006 * step, 0.5))))
        assert told.phase in ("moving", "holding")
        assert told.words
    assert operator.guide.views == ()


def test_few_frames_are_no_proof_of_stillness(operator: Operator) -> None:
    """A slow search gives a frame now and then; two that agree may be chance."""
    view = operator.view(operator.stand())
    phases = [operator.guide.look(view, number * 2 * HOLD_NS).phase for number in range(3)]
    assert phases == ["moving", "holding", "taken"]


def test_a_near_duplicate_is_refused_with_a_word(operator: Operator) -> None:
    operator.hold(operator.stand())
    operator.hold(operator.stand(place=(0.2, 0.2)))
    again = operator.hold(operator.stand())[-1]
    assert (again.phase, again.code, again.taken) == ("refused", "near_duplicate", None)
    assert again.words.startswith("as in view-001.png; ")
    assert len(operator.guide.views) == 2


def test_a_blurred_board_is_refused_until_it_is_sharp(operator: Operator) -> None:
    blurred = operator.hold(operator.stand(), edge_px=BLURRED_PX + 3)[-1]
    assert (blurred.phase, blurred.code) == ("refused", "blurred")
    assert "8 px" in blurred.words
    assert operator.show(operator.view(operator.stand())).phase == "taken"


def test_a_board_that_vanishes_begins_anew(operator: Operator) -> None:
    operator.hold(operator.stand(), frames=4)
    assert operator.show(Miss("", "partial", "only 5 corners are seen")).phase == "looking"
    assert operator.show(operator.view(operator.stand())).phase == "moving"


def test_pictures_of_another_size_are_refused(operator: Operator) -> None:
    operator.hold(operator.stand())
    told = operator.show(replace(operator.view(operator.stand()), size=(640, 360)))
    assert (told.phase, told.code) == ("refused", "other_size")
    assert "640x360" in told.words
    assert "1280x720" in told.words
    assert operator.hold(operator.stand(place=(0.2, 0.2)))[-1].phase == "taken"


def test_it_says_how_to_get_to_the_next_pose(operator: Operator) -> None:
    told = operator.hold(operator.stand())[-1]
    assert told.wish is not None
    assert told.wish.code == "tilt_right"
    assert told.wish.place == pytest.approx((1 / 6, 1 / 6))
    start = operator.stand(place=(0.8, 0.8))
    words = operator.show(operator.view(start)).words
    assert "move it to the left and up in the picture" in words
    assert "tilt it more to the right" in words
    there = operator.show(operator.view(operator.stand(told.wish))).words
    assert there.endswith("hold it there")


def test_frontal_views_alone_are_asked_to_tilt_and_stop_being_taken(operator: Operator) -> None:
    for number in range(60):
        place = (0.2 + 0.6 * (number % 8) / 7, 0.2 + 0.6 * (number // 8) / 7)
        told = operator.hold(operator.stand(place=place, share=0.3))[-1]
    assert len(operator.guide.views) <= ENOUGH + 5  # some still cover more of the picture
    assert not operator.guide.wants_verdict
    assert told.phase == "refused"
    assert {"tilt_right", "tilt_left", "tilt_top", "tilt_bottom"} <= {wish.code for wish in told.missing}


def test_a_verdict_that_is_not_good_says_what_to_show(operator: Operator) -> None:
    guide = Guide(BOARD, (1280, 720), Camera(noise_px=1.0).good_views(np.random.default_rng(3), 24))
    assert guide.wants_verdict
    told = guide.judge(calibrate(guide.views, models=("5",)))
    assert told.verdict is not None
    assert told.verdict.level != "good"
    assert told.wish is not None
    assert told.words.startswith(told.verdict.level)
    assert not guide.done
    assert not guide.wants_verdict  # until there is a new view


def test_it_goes_on_with_earlier_views(operator: Operator) -> None:
    operator.hold(operator.stand())
    guide = Guide(BOARD, (1280, 720), operator.guide.views)
    operator.guide = guide
    told = operator.hold(operator.stand(place=(0.2, 0.2), tilt_deg=30.0, towards_deg=90.0))[-1]
    assert told.count == 2
    assert [view.name for view in guide.views] == ["view-001.png", "view-002.png"]


def test_what_it_says_is_plain_data_for_programs(operator: Operator) -> None:
    operator.show(Miss("", "no_board", "no board found"))
    answers = operator.hold(operator.stand())
    document = json.loads(json.dumps(answers[4].document()))
    assert (document["phase"], document["taken"], document["views"]) == ("taken", "view-001.png", 1)
    assert np.shape(document["ghost"]) == np.shape(document["outline"]) == (4, 2)
    assert sum(map(sum, document["cells"])) == 54
    assert document["tilts"]["straight"] == 1
    assert document["next"]["code"] == document["missing"][0] == "tilt_right"


def test_a_view_that_is_asked_for_is_taken_at_once_and_can_be_dropped(operator: Operator) -> None:
    guide = operator.guide
    operator.show(operator.view(operator.stand()))
    guide.demand()
    told = operator.show(operator.view(operator.stand(place=(0.3, 0.3))))
    assert (told.phase, told.count) == ("taken", 1)
    guide.demand()
    told = operator.show(Miss("", "no_board", "no board found"))
    assert (told.phase, told.code) == ("looking", "no_board")
    assert operator.show(operator.view(operator.stand())).phase == "moving", "a demand is for one frame"
    guide.demand()
    told = operator.show(operator.view(operator.stand(place=(0.3, 0.3))))
    assert (told.phase, told.code) == ("refused", "near_duplicate")
    told = guide.drop_last()
    assert (told.phase, told.code, told.count, guide.views) == ("looking", "dropped", 0, ())
    assert guide.drop_last().code == "nothing_to_drop"
    guide.demand()
    assert operator.show(operator.view(operator.stand(place=(0.3, 0.3)))).count == 1


def test_what_the_views_lack_is_told_before_there_is_a_fit(operator: Operator) -> None:
    lacks = operator.show(Miss("", "no_board", "no board found")).document()["lacks"]
    assert lacks == ["there are only 0 different views; take 10 or more"]
    told = operator.hold(operator.stand())[-1]
    assert told.so_far is not None
    assert told.so_far.level == "not yet"
    assert told.document()["lacks"][0].startswith("there are only 1 different views")
