"""What requests under way keep others from, and what control adds to label's answers; the talks alone, no sockets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from common import clock
from common.bus import Endpoints
from common.commands import RecordCommand, ReloadCommand, SessionCommand, StartCommand, UndoCommand
from common.config import load_rig
from common.config.models import NetworkConfig
from common.errors import RefusedError
from common.messages import Answer, ErrorInfo
from services.control.conversations import Keys, Talk
from services.control.service import handlers
from services.control.stack import SETTLE_AT_LATEST_NS, Stack
from tests.unit.services.control.known import SECOND, camera, ledger, recording_state, service, spec

NOW = SETTLE_AT_LATEST_NS
RIG = """\
dataset: {root: ./data, session: monday}
cameras:
  cam0: {driver: synthetic, width: 320, height: 240}
workers: {detect: 1, label: 1}
"""


@pytest.fixture
def stack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Stack:
    monkeypatch.setattr(clock, "monotonic_ns", lambda: NOW)
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    made = Stack(load_rig(path), Endpoints.of(NetworkConfig()), now_ns=0)
    for name in ("detect.0", "label.0", "store"):
        made.hear(service(name), name, NOW)
    made.hear(camera("cam0"), "capture.cam0", NOW)
    made.tick(NOW)
    return made


def refused(talk: Talk) -> str:
    with pytest.raises(RefusedError) as error:
        next(talk)
    return error.value.code


def end(talk: Talk, *answers: Answer) -> dict[str, Any]:
    with pytest.raises(StopIteration) as ended:
        talk.send(answers)
    plain: dict[str, Any] = ended.value.value
    return plain


def test_nothing_is_begun_while_the_rig_is_reloaded(stack: Stack) -> None:
    table = handlers(stack, Keys("b"))
    reload = table["reload"](ReloadCommand())
    next(reload)
    assert refused(table["record"](RecordCommand(camera="cam0"))) == "busy"
    assert refused(table["start"](StartCommand(camera="cam0"))) == "busy"
    assert refused(table["reload"](ReloadCommand())) == "busy"
    reload.send((Answer(key="k"),))
    assert end(reload, Answer(key="k"))["changed"] == []
    next(table["start"](StartCommand(camera="cam0")))


@pytest.mark.parametrize("how", ["answered", "given up"])
def test_no_session_is_opened_while_a_request_wants_several_samples(stack: Stack, how: str) -> None:
    table = handlers(stack, Keys("b"))
    record = table["record"](RecordCommand(camera="cam0", count=3))
    next(record)
    assert refused(table["session"](SessionCommand(name="tuesday"))) == "wrong_state"
    if how == "answered":
        end(record, Answer(key="k"))
    else:
        record.close()
    single = table["record"](RecordCommand(camera="cam0"))
    next(single)
    next(table["session"](SessionCommand(name="tuesday")))


def test_a_session_is_opened_instead_of_one_that_is_gone_though_a_recording_can_not_be_ended(stack: Stack) -> None:
    """`stop` is refused with `no_dataset` and the advice to open another session."""
    table = handlers(stack, Keys("b"))
    stack.hear(recording_state(ledger(spec("rec-a", "cam0"), "finishing", cam0=3)), "label.0", NOW)
    assert refused(table["session"](SessionCommand(name="tuesday"))) == "wrong_state"
    stack.hear(service("store", texts={"session": "monday", "problem": "no_dataset"}), "store", NOW)
    next(table["session"](SessionCommand(name="tuesday")))


@pytest.mark.parametrize(
    ("detect", "present", "told"), [(True, True, "no_frame"), (False, True, "detect_down"), (False, False, "no_frame")]
)
def test_frames_that_nobody_looks_at_are_told_from_a_camera_without_frames(
    stack: Stack, monkeypatch: pytest.MonkeyPatch, detect: bool, present: bool, told: str
) -> None:
    later = NOW + 4 * SECOND
    monkeypatch.setattr(clock, "monotonic_ns", lambda: later)
    if detect:
        stack.hear(service("detect.0"), "detect.0", later)
    if present:
        stack.hear(camera("cam0"), "capture.cam0", later)
    record = handlers(stack, Keys("b"))["record"](RecordCommand(camera="cam0"))
    next(record)
    error = end(record, Answer(key="k", error=ErrorInfo(code="no_frame", message="no frame came")))["error"]
    assert error["code"] == told
    assert ("detect.0" in error["message"]) is (told == "detect_down")


def test_a_second_undo_is_refused_until_the_first_has_its_answer(stack: Stack) -> None:
    undo = handlers(stack, Keys("b"))["undo"]
    first = undo(UndoCommand())
    next(first)
    assert refused(undo(UndoCommand())) == "busy"
    move = first.send((Answer(key="k", samples=("a",)),))
    assert [errand.order.samples for errand in move.errands] == [("a",)], "the very one that was named"  # type: ignore[attr-defined]
    assert end(first, Answer(key="k", samples=("a",))) == {"samples": ["a"]}
    again = undo(UndoCommand())
    next(again)
    again.close()
    next(undo(UndoCommand()))
