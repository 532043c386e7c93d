"""Which samples look wrong, and why: every measure against what is usual in its session. Pure.

A score of 1 is where doubt begins. Limits are of two kinds: fixed ones for what can't be (a label that contradicts
itself, a marker that is still there) and ones that follow the session, for what depends on camera, room and light.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from tools.inspect.consistency import OFF_LIMIT_PX
from tools.inspect.facts import Facts, ObjectFacts, Reason, Suspect
from tools.inspect.neighbours import neighbour_reasons

FIT_PX = 1.5
"""As `mode: auto` asks of a sample (services.label.auto)."""
PATTERN = 0.6
_MOST = 50.0
_DEPTH_MM, _DEPTH_SHARE = 12.0, 0.025
_ORIGINAL_PX = 1.5
_CHANGED = 0.002
_SIGMA_PX = 3.0
_DARK, _BRIGHT = 25.0, 235.0
_OUTLINE = 2.0
_FEW = 5
"""With fewer values nothing is usual."""


def suspects(facts: Sequence[Facts]) -> list[Suspect]:
    """All samples, the most suspicious first; those without any reason last, in the order of time."""
    around = neighbour_reasons(facts)
    judge = _Judge(facts)
    found = []
    for index, sample in enumerate(facts):
        reasons = [*judge.reasons(sample), *around.get(index, ())]
        reasons = [Reason(one.kind, one.text, min(one.score, _MOST)) for one in reasons if one.score > 1.0]
        found.append(Suspect(sample, tuple(sorted(reasons, key=lambda one: -one.score))))
    return sorted(found, key=lambda one: (-one.score, one.facts.sample))


class _Judge:
    """Knows what is usual in a session."""

    def __init__(self, facts: Sequence[Facts]) -> None:
        items = [item for sample in facts for item in sample.objects]
        self._residual = _median([item.residual_px for item in items])
        self._sigma = _median([item.corner_sigma_px for item in items])
        self._depth = _median([item.depth_mm for item in items])
        self._original = _median([sample.original_px for sample in facts])
        self._outline = {
            name: _usual([item.outline for item in items if item.name == name]) for name in {one.name for one in items}
        }
        self._blur = {
            camera: _usual([one.blur for one in facts if one.camera == camera and one.readable])
            for camera in {one.camera for one in facts}
        }
        self._twins = Counter(sample.pixels for sample in facts if sample.pixels is not None)

    def reasons(self, sample: Facts) -> Iterator[Reason]:
        for problem in sample.problems:
            if problem.kind != "contradiction":  # told in detail below
                yield Reason(problem.kind, problem.message, 10.0)
        if not sample.readable:
            return
        yield from self._of_picture(sample)
        for item in sample.objects:
            for check in _CHECKS:
                yield from check(self, item)

    def _of_picture(self, sample: Facts) -> Iterator[Reason]:
        if sample.remains:
            ids = ", ".join(map(str, sample.remains))
            yield Reason("marker", f"the stored picture still shows marker {ids}", 8.0)
        if sample.pixels is not None and self._twins[sample.pixels] > 1:
            yield Reason("same_picture", "another sample has the very same picture", 9.0)
        if sample.original_px is not None:
            limit = max(_ORIGINAL_PX, 4 * self._original)
            text = f"the markers in the original are {sample.original_px:.1f} px from where the label has them"
            yield Reason("original", text, sample.original_px / limit)
        if sample.changed is not None:
            text = f"{sample.changed:.1%} of the picture differs from the original where nothing was erased"
            yield Reason("changed", text, sample.changed / _CHANGED)
        usual, spread = self._blur[sample.camera]
        text = f"it is blurred ({sample.blur:.2f}, usual are {usual:.2f})"
        yield Reason("blur", text, (sample.blur - usual) / max(6 * spread, 0.06))
        if sample.brightness < _DARK:
            text = f"it is dark (mean {sample.brightness:.0f} of 255)"
            yield Reason("dark", text, 1 + (_DARK - sample.brightness) / _DARK * 4)
        elif sample.brightness > _BRIGHT:
            text = f"it is overexposed (mean {sample.brightness:.0f} of 255)"
            yield Reason("bright", text, 1 + (sample.brightness - _BRIGHT) / (255 - _BRIGHT) * 4)
        if not sample.complete:
            yield Reason("incomplete", "an object that should be in view has no pose", 2.0)

    def residual(self, item: ObjectFacts) -> Iterator[Reason]:
        text = f"{item.name}'s markers are {item.residual_px:.1f} px from where its pose puts them"
        yield Reason("residual", text, item.residual_px / max(FIT_PX, 6 * self._residual))

    def contradiction(self, item: ObjectFacts) -> Iterator[Reason]:
        for text in item.wrong:
            yield Reason("rig", text, 8.0)
        text = f"{item.name}'s corners or windows are {item.off_px:.1f} px from where its own pose puts them"
        yield Reason("itself", text, item.off_px / OFF_LIMIT_PX)

    def depth(self, item: ObjectFacts) -> Iterator[Reason]:
        if item.depth_mm is None or item.depth_signed_mm is None:
            return
        limit = max(_DEPTH_MM, _DEPTH_SHARE * item.distance_mm, 4 * self._depth)
        way = "behind" if item.depth_signed_mm > 0 else "before"
        text = f"depth sees {item.name}'s surface {item.depth_mm:.0f} mm {way} the one of its pose"
        yield Reason("depth", text, item.depth_mm / limit)

    def outline(self, item: ObjectFacts) -> Iterator[Reason]:
        usual, spread = self._outline[item.name]
        if item.outline is None or usual < _OUTLINE:
            return
        text = f"the picture has no edges where {item.name}'s outline should be"
        limit = max(usual - 4 * spread, 0.5 * usual) - 0.3
        yield Reason("outline", text, 1 + (limit - item.outline))

    def remains(self, item: ObjectFacts) -> Iterator[Reason]:
        text = f"marker {item.pattern_marker} of {item.name} still shows through ({item.pattern:.2f})"
        yield Reason("pattern", text, 1 + (item.pattern - PATTERN) * 10)

    def uncertain(self, item: ObjectFacts) -> Iterator[Reason]:
        if item.corner_sigma_px is not None:
            text = f"{item.name}'s corners are known to {item.corner_sigma_px:.1f} px only"
            yield Reason("uncertain", text, min(item.corner_sigma_px / max(_SIGMA_PX, 8 * self._sigma), 3.0))
        if item.ambiguous:
            yield Reason("ambiguous", f"{item.name} fits a second pose as well", 2.0)


_CHECKS: tuple[Callable[[_Judge, ObjectFacts], Iterator[Reason]], ...] = (
    _Judge.residual,
    _Judge.contradiction,
    _Judge.depth,
    _Judge.outline,
    _Judge.remains,
    _Judge.uncertain,
)


def _median(values: Sequence[float | None]) -> float:
    known = [value for value in values if value is not None and np.isfinite(value)]
    return float(np.median(known)) if len(known) >= _FEW else 0.0


def _usual(values: Sequence[float | None]) -> tuple[float, float]:
    """Median, and a standard deviation that outliers don't move (from the median absolute deviation)."""
    known = np.array([value for value in values if value is not None and np.isfinite(value)])
    if len(known) < _FEW:
        return (float(np.median(known)) if len(known) else 0.0), float("inf")
    middle = float(np.median(known))
    return middle, 1.4826 * float(np.median(np.abs(known - middle)))
