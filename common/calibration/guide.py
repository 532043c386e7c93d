"""Guided calibration: frame in; out what is missing, the next pose to hold, whether this frame was taken or why not.

Pure: no clock, no file, no thread. Whoever drives it (the command, the console) finds the board in a frame
(``BoardFinder``), gives what was found to ``Guide.look`` with the frame's time, keeps the pictures of views that were
taken, and calibrates when ``Guide.wants_verdict`` says so (that takes seconds), handing the outcome to ``Guide.judge``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from common.boards import Board
from common.calibration.detect import BLURRED_PX, Miss
from common.calibration.diversity import SAME_SHARE, Stance, difference, distinct, nearest, spread, stance
from common.calibration.engine import MOST_VIEWS, Outcome
from common.calibration.ghost import ghost, hints, outline_of
from common.calibration.guidance import NEXT_PHASES, Guidance, Phase
from common.calibration.verdict import GOOD_VIEWS, judge_views, verdict, where
from common.calibration.views import View
from common.calibration.wishes import TILTS, Wish, in_words, place_of, tilt_counts, wishes
from common.geometry import CameraModel

Array = NDArray[np.float64]
HOLD_NS = 400_000_000
"""So long the board has to be still."""
LEAST_FRAMES = 3
STILL_SHARE = 0.003
"""The mean corner may wander by this share of the picture's diagonal meanwhile: hands are never quite still."""
UNLIKE_SHARE, UNLIKE_DEG = 0.05, 12.0
"""A view is worth taking if its corners lie so far from every other's (as a share of the diagonal) or it is tilted so
differently; less than that only where it adds what is missing."""
ENOUGH = 30
"""From so many views on only those are taken that add what is missing."""


class Guide:
    """Guides through one calibration with pictures of one ``size`` (width, height).

    ``views``: those of an earlier session, to go on with.
    """

    def __init__(self, board: Board, size: tuple[int, int], views: Sequence[View] = ()) -> None:
        self._board = board
        self._size = size
        self._views = list(views)
        self._trail: deque[tuple[int, View]] = deque()
        self._phase: Phase = "looking"
        self._answer: Guidance | None = None
        self._outcome: Outcome | None = None
        self._judged_at = 0
        self._demanded = False
        self._dropped = 0
        self._summarise()

    @property
    def views(self) -> tuple[View, ...]:
        """What was taken, those of an earlier session first."""
        return tuple(self._views)

    @property
    def outcome(self) -> Outcome | None:
        """The newest verdict."""
        return self._outcome

    @property
    def done(self) -> bool:
        """Whether the views are good, or so many that more won't help."""
        return self._phase == "done"

    @property
    def wants_verdict(self) -> bool:
        """Whether to calibrate now: nothing is missing that can be told without, and there are new views."""
        if self.done or len(self._views) < max(GOOD_VIEWS, self._judged_at + 1):
            return False
        return self._complete or len(self._views) >= MOST_VIEWS

    def judge(self, outcome: Outcome) -> Guidance:
        """Take note of a calibration from these views: it ends the guide, or says what is missing."""
        self._outcome, self._judged_at = outcome, len(self._views)
        if outcome.verdict.level == "good":
            self._enter("done")
            return self._guidance(f"the calibration is good, from {len(self._views)} views")
        if len(self._views) >= MOST_VIEWS:
            self._enter("done")
            return self._guidance(f"{len(self._views)} views are enough: {outcome.verdict.sentence}", "enough")
        self._summarise()
        return self._guidance(outcome.verdict.sentence)

    def demand(self) -> None:
        """The operator asks for a view now: the next frame is taken or refused whether or not the board is still."""
        self._demanded = True

    def drop_last(self) -> Guidance:
        """Take back the newest view; what is missing is told without it."""
        if self.done or not self._views:
            return self._guidance("there is no view to drop", "nothing_to_drop")
        gone = self._views.pop()
        self._dropped += 1
        self._judged_at, self._answer = 0, None
        self._trail.clear()
        self._summarise()
        if self._phase != "looking":
            self._enter("looking")
        return self._guidance(f"{gone.name} is dropped; {self._next_words()}", "dropped")

    def look(self, found: View | Miss, at_ns: int) -> Guidance:
        """What a frame, taken at ``at_ns`` (any clock that never runs backwards), changes."""
        demanded, self._demanded = self._demanded, False
        if self.done:
            return self._guidance("the calibration is over")
        if isinstance(found, Miss):
            self._trail.clear()
            self._enter("looking")
            return self._guidance(f"{found.reason}; {self._next_words()}", found.code)
        if found.size != self._size:
            return self._refuse_size(found)
        drawn = outline_of(self._board, found, self._camera)
        held = self._held(found, at_ns)
        if held < 1.0 and not demanded:
            self._answer = None
            self._enter("holding" if len(self._trail) > 1 else "moving")
            words = "hold it" if held > 0 else self._correction(found, drawn)
            return self._guidance(words, held=held, drawn=drawn)
        if (
            self._answer is not None and not demanded
        ):  # already answered for this pose; nothing more until the board moves
            return replace(self._answer, outline=drawn, taken=None)
        self._enter("holding")
        answer = self._decide(found, drawn)
        # A lens may still be focusing; everything else stays as it is until the board moves.
        self._answer = None if answer.code == "blurred" else answer
        return answer

    # --- whether a view is taken

    def _held(self, view: View, at_ns: int) -> float:
        """How much of the time that it must be still the board has been (0..1); starts anew where it moved."""
        if any(difference(view, earlier) > STILL_SHARE for _, earlier in self._trail):
            self._trail.clear()
        self._trail.append((at_ns, view))
        while len(self._trail) > LEAST_FRAMES and at_ns - self._trail[1][0] >= HOLD_NS:
            self._trail.popleft()
        share = min(1.0, (at_ns - self._trail[0][0]) / HOLD_NS)
        return share if len(self._trail) >= LEAST_FRAMES else min(share, 0.9)

    def _decide(self, view: View, drawn: Array) -> Guidance:
        code, why = self._fault(view)
        if code:
            self._enter("refused")
            return self._guidance(why, code, held=1.0, drawn=drawn)
        taken = replace(view, name=self._free_name())
        self._views.append(taken)
        self._summarise()
        self._enter("taken")
        words = f"{taken.name} is taken; next: {self._next_words()}"
        return self._guidance(words, held=1.0, drawn=drawn, taken=taken)

    def _fault(self, view: View) -> tuple[str, str]:
        """Why a still view is not taken: code and words, empty for one that is."""
        if view.edge_px > BLURRED_PX:
            return "blurred", f"blurred (edges {view.edge_px:.0f} px wide): focus, or give more light"
        like, apart = nearest(view, self._views)
        if like is not None and apart < SAME_SHARE:
            return "near_duplicate", f"as in {like.name}; {self._next_words()}"
        if self._adds(view):
            return "", ""
        if like is not None and not self._unlike(view):
            return "near_duplicate", f"much like {like.name}; {self._next_words()}"
        if len(self._views) >= ENOUGH and self._missing:
            return "nothing_new", f"there are views enough of this kind; {self._next_words()}"
        return "", ""

    def _unlike(self, view: View) -> bool:
        """Whether it differs from every other view by place, size or tilt."""
        now = self._stance(view)
        for other, stood in zip(self._views, self._seen.stances, strict=True):
            turned = np.degrees(np.arccos(np.clip(np.dot(now.normal, stood.normal), -1, 1)))
            if turned < UNLIKE_DEG and difference(view, other) < UNLIKE_SHARE:
                return False
        return True

    def _adds(self, view: View) -> bool:
        """Whether it brings some of what is missing."""
        missing = {wish.code for wish in self._missing}
        before, after = self._seen, spread([*self._views, view], self._camera)
        counts, more = tilt_counts(before), tilt_counts(after)
        tilted = any(more[way] > counts[way] and missing & {way, f"tilt_{way}"} for way in counts)
        covering = "cover" in missing and (after.cells > 0).sum() > (before.cells > 0).sum()
        nearer = "nearer" in missing and after.distance_ratio > 1.05 * before.distance_ratio
        return bool(tilted or covering or nearer)

    # --- what is missing

    def _summarise(self) -> None:
        self._seen = spread(self._views, self._camera)
        self._missing = wishes(self._seen) or self._asked_for()
        different = len(distinct(self._views)[0])
        self._so_far = verdict(judge_views(self._views, different, self._seen))
        self._complete = bool(self._views) and self._so_far.level == "good"

    def _asked_for(self) -> tuple[Wish, ...]:
        """What a verdict that isn't good calls for, once all that can be told without it is there."""
        if self._outcome is None or self._outcome.verdict.level == "good":
            return ()
        solution = self._outcome.solution
        codes = {reason.code for reason in self._outcome.verdict.reasons}
        if solution is not None and "unsure_rim" in codes:
            part = solution.map.worst_place
            return (Wish("cover", f"show the board {in_words(part)}", place_of(part), 20.0, 0.0),)
        counts = tilt_counts(self._seen)
        side, angle = min(TILTS, key=lambda tilt: counts[tilt[0]])
        part = where(self._seen, seen=False).split(" and ", maxsplit=1)[0]
        words = f"tilt the board so that it looks to the {side}, {in_words(part)}"
        return (Wish(f"tilt_{side}", words, place_of(part), 40.0, angle),)

    def _next_words(self) -> str:
        return self._missing[0].words if self._missing else "move the board to another place, tilted otherwise"

    def _correction(self, view: View, drawn: Array) -> str:
        if not self._missing:
            return self._next_words()
        wish = self._missing[0]
        wanted = ghost(self._board, wish, self._camera)
        todo = hints(drawn, self._stance(view), wish, wanted, view.size)
        return f"{wish.words}: {', '.join(todo)}" if todo else f"{wish.words}: hold it there"

    # --- small things

    @property
    def _camera(self) -> CameraModel:
        """The newest calibration's, or a guess."""
        solution = None if self._outcome is None else self._outcome.solution
        return CameraModel.guess(*self._size) if solution is None else solution.camera

    def _stance(self, view: View) -> Stance:
        return stance(view, self._camera)

    def _free_name(self) -> str:
        names = {view.name for view in self._views}
        number = len(self._views) + 1
        while f"view-{number:03d}.png" in names:
            number += 1
        return f"view-{number:03d}.png"

    def _refuse_size(self, view: View) -> Guidance:
        first, now = ("x".join(map(str, size)) for size in (self._size, view.size))
        self._trail.clear()
        self._enter("holding")
        self._enter("refused")
        words = f"the pictures are {now} now, they were {first}: a calibration belongs to one size"
        return self._guidance(words, "other_size")

    def _enter(self, phase: Phase) -> None:
        if phase != self._phase and phase not in NEXT_PHASES[self._phase]:
            raise ValueError(f"a guide doesn't go from {self._phase} to {phase}")
        self._phase = phase

    def _guidance(
        self, words: str, code: str = "", *, held: float = 0.0, drawn: Array | None = None, taken: View | None = None
    ) -> Guidance:
        wish = self._missing[0] if self._missing and not self.done else None
        shape = None if wish is None else ghost(self._board, wish, self._camera)
        known = None if self._outcome is None else self._outcome.verdict
        return Guidance(
            self._phase, words, self._size, code, held, wish, shape, drawn, taken, len(self._views), self._seen,
            self._missing, known, self._so_far, self._dropped,
        )  # fmt: skip
