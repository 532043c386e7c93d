"""What becomes of a frame once its exact labels are known, and what whoever asked is told."""

from __future__ import annotations

from typing import Any

from common.labels import Erased, LeftOut, Missing
from services.label.contradictions import Contradictions
from services.label.exact import Finished
from services.label.labelling import Labelled
from services.label.verdict import verdict
from tests.support.samples import object_label

GONE = Missing(object="box-2", reason="not_detected", seen_ms_ago=240.0)


def finished(objects: int = 1, missing: tuple[Missing, ...] = (), *, ambiguous: bool = False, **keep: bool) -> Finished:
    label = object_label()
    label = label.model_copy(update={"quality": label.quality.model_copy(update={"ambiguous": ambiguous})})
    return Finished(
        objects=(label,) * objects,
        left_out=(),
        missing=missing,
        inpainted=Erased(method="telea", margin="", polygons=()),
        keep_ambiguous=keep.get("ambiguous_kept", False),
        keep_incomplete=keep.get("incomplete_kept", False),
    )


def code(result: Finished, *, background: bool = False) -> str | None:
    refusal = verdict(result, background=background)
    return None if refusal is None else refusal.code


def test_good_labels_are_a_sample() -> None:
    assert code(finished()) is None


def test_an_ambiguous_pose_refuses_the_whole_sample_and_says_what_helps() -> None:
    refusal = verdict(finished(ambiguous=True), background=False)
    assert refusal is not None
    assert refusal.code == "ambiguous_pose"
    assert refusal.message.startswith("box-0: ")
    assert "by 5 degrees" in refusal.message
    assert "second marker" in refusal.message
    assert code(finished(ambiguous=True, ambiguous_kept=True)) is None


def test_a_missing_object_refuses_it_by_name_unless_it_is_to_be_kept() -> None:
    refusal = verdict(finished(missing=(GONE,)), background=False)
    assert refusal is not None
    assert refusal.code == "incomplete"
    assert "box-2 was seen 0.2 s ago" in refusal.message
    assert code(finished(missing=(GONE,), incomplete_kept=True)) is None
    assert code(finished(objects=0, missing=(GONE,), incomplete_kept=True)) == "incomplete"  # nothing to keep


def test_background_has_no_object_not_even_one_without_a_pose() -> None:
    assert code(finished(objects=0), background=True) is None
    assert code(finished(), background=True) == "object_in_view"
    assert code(finished(objects=0, missing=(GONE,)), background=True) == "object_in_view"


def test_no_object_is_no_sample() -> None:
    assert code(finished(objects=0)) == "no_object"


class Log:
    def __init__(self) -> None:
        self.heard: list[dict[str, Any]] = []

    def warning(self, event: str, **fields: Any) -> None:
        self.heard.append({"event": event, **fields})


def test_a_marker_that_contradicts_is_named_once() -> None:
    entry = LeftOut(marker=4, reason="contradicts", object="box-1", residual_px=31.25)
    log = Log()
    named = Contradictions(log)  # type: ignore[arg-type]
    for _ in range(5):
        named.hear("cam0", Labelled((), (entry,)))
    assert [(item["event"], item["marker"], item["residual_px"]) for item in log.heard] == [
        ("marker.contradicts", 4, 31.2)
    ]
    named.hear("cam1", Labelled((), (entry,)))
    named.forget()
    named.hear("cam0", Labelled((), (entry,)))
    assert len(log.heard) == 3
