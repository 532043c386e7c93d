"""Whether the exact labels of a frame make it a sample, and the sentence for whoever asked if not. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from common.labels import Missing
from services.label.exact import Finished
from services.label.requests import explain

_WHY = {
    "not_detected": "none of its markers is found now (moved too fast, covered, or turned away)",
    "bad_pose": "its marker gives no pose",
    "contradicts": "its markers contradict each other",
    "duplicate_marker": "its marker is seen at several places",
}


class Refusal(NamedTuple):
    """A stable code and one sentence."""

    code: str
    message: str


def verdict(result: Finished, *, background: bool) -> Refusal | None:
    """Why the exact labels forbid the sample, None if they are good."""
    if background:
        return _plain("object_in_view") if result.objects or result.missing else None
    if result.missing and not (result.keep_incomplete and result.objects):
        return Refusal("incomplete", missing_sentence(result.missing))
    if not result.objects:
        return _plain("no_object")
    doubtful = [item.name for item in result.objects if item.quality.ambiguous]
    if doubtful and not result.keep_ambiguous:
        return Refusal("ambiguous_pose", f"{', '.join(doubtful)}: {explain('ambiguous_pose')}")
    return None


def missing_sentence(missing: Sequence[Missing]) -> str:
    """Which objects have no pose, why, and what to do."""
    parts = []
    for item in missing:
        ago = "" if item.seen_ms_ago is None else f" was seen {item.seen_ms_ago / 1000:.1f} s ago and"
        parts.append(f"{item.object}{ago} should have a pose, but {_WHY.get(item.reason, item.reason)}")
    return f"{'; '.join(parts)}; hold still, show a marker, or take it out of the picture"


def _plain(code: str) -> Refusal:
    return Refusal(code, explain(code))
