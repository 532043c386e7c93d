"""Each client gets exactly one answer, whatever peers and handlers do, and nothing waits for anything."""

from __future__ import annotations

from collections import defaultdict

import pytest

from common import clock
from common.errors import ConfigError, RefusedError
from common.messages import Answer, ErrorInfo, LedgerQuery, Order
from services.control.conversations import MAX_WAITING, Batch, Conversations, Errand, Plain, Talk


class Post:
    """Carries orders nowhere; peers named in ``away`` can't be reached."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, str]] = []
        self.forgotten: list[tuple[str, str]] = []
        self.away: set[str] = set()

    def send(self, peer: str, order: Order, *, lasting: bool = False) -> None:
        if peer in self.away and not lasting:
            raise RefusedError(f"{peer} is away", code=f"{peer}_down")
        self.sent.append((peer, order.key))

    def forget(self, peer: str, key: str) -> None:
        self.forgotten.append((peer, key))


class Room:
    """Conversations with the answers that the clients got."""

    def __init__(self) -> None:
        self.post = Post()
        self.answers: dict[str, list[Plain]] = defaultdict(list)
        self.all: Conversations[str] = Conversations(
            self.post, lambda client, answer: self.answers[client].append(answer)
        )

    def code(self, client: str) -> str:
        (answer,) = self.answers[client]
        code: str = answer["error"]["code"]
        return code


@pytest.fixture
def room() -> Room:
    return Room()


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The clock, in nanoseconds, to be set by the test."""
    told = [0]
    monkeypatch.setattr(clock, "monotonic_ns", lambda: told[0])
    return told


def errand(key: str, peer: str = "store") -> Errand:
    return Errand(peer, LedgerQuery(key=key))


def asks(*batches: Batch) -> Talk:
    """Asks the batches in turn and answers with everything that came back."""
    told: list[str | None] = []
    for batch in batches:
        answers = yield batch
        told += [answer.error.code if answer.error else answer.text for answer in answers]
    return {"told": told}


def test_a_talk_without_orders_is_answered_at_once(room: Room) -> None:
    room.all.begin("client", asks())
    assert room.answers["client"] == [{"ok": True, "told": []}]
    assert room.all.waiting == 0


def test_answers_come_back_in_the_order_of_the_errands(room: Room) -> None:
    room.all.begin("client", asks(Batch((errand("a"), errand("b")), 1.0), Batch((errand("c"),), 1.0)))
    room.all.arrived(Answer(key="b", text="B"))
    assert not room.answers["client"]
    room.all.arrived(Answer(key="a", text="A"))
    assert room.post.sent == [("store", "a"), ("store", "b"), ("store", "c")]
    room.all.arrived(Answer(key="c", error=ErrorInfo(code="disk_full", message="full")))
    assert room.answers["client"] == [{"ok": True, "told": ["A", "B", "disk_full"]}]


def test_a_peer_that_is_away_answers_by_its_refusal(room: Room) -> None:
    room.post.away = {"label"}
    room.all.begin("client", asks(Batch((errand("a", "label"), errand("b")), 1.0)))
    room.all.arrived(Answer(key="b", text="B"))
    assert room.answers["client"] == [{"ok": True, "told": ["label_down", "B"]}]


def test_time_runs_out_for_what_is_open_only_and_its_orders_are_forgotten(room: Room, now: list[int]) -> None:
    room.all.begin("client", asks(Batch((errand("a"), errand("b")), 2.0), Batch((errand("c"),), 2.0)))
    room.all.arrived(Answer(key="a", text="A"))
    now[0] = 2 * 10**9 - 1
    room.all.tick()
    assert room.post.forgotten == []
    now[0] += 1
    room.all.tick()
    assert room.post.forgotten == [("store", "b")]
    room.all.arrived(Answer(key="b", text="too late"))
    assert room.all.late == 1
    now[0] += 2 * 10**9 - 1
    room.all.tick()
    assert not room.answers["client"], "the second batch has its own time"
    room.all.arrived(Answer(key="c", text="C"))
    assert room.answers["client"] == [{"ok": True, "told": ["A", "timeout", "C"]}]


def test_a_repeated_or_unknown_answer_changes_nothing(room: Room) -> None:
    room.all.begin("client", asks(Batch((errand("a"),), 1.0)))
    room.all.arrived(Answer(key="x"))
    room.all.arrived(Answer(key="a", text="A"))
    room.all.arrived(Answer(key="a", text="again"))
    assert room.answers["client"] == [{"ok": True, "told": ["A"]}]
    assert room.all.late == 2


def refuses(error: Exception) -> Talk:
    yield from ()
    raise error


def test_an_expected_error_is_the_refusal(room: Room) -> None:
    room.all.begin("client", refuses(RefusedError("not now", code="busy")))
    assert room.answers["client"] == [{"ok": False, "error": {"code": "busy", "message": "not now"}}]


def test_all_mistakes_of_a_configuration_go_along(room: Room) -> None:
    room.all.begin("client", refuses(ConfigError("2 mistakes", ("rig.yaml:1: a: b", "rig.yaml:2: c: d"))))
    (answer,) = room.answers["client"]
    assert answer["error"]["code"] == "bad_config"
    assert answer["problems"] == ["rig.yaml:1: a: b", "rig.yaml:2: c: d"]


def test_a_bug_costs_its_own_command_only(room: Room) -> None:
    room.all.begin("other", asks(Batch((errand("a"),), 1.0)))
    room.all.begin("client", refuses(ZeroDivisionError("oh")))
    assert room.code("client") == "failed"
    assert room.all.bugs == 1
    room.all.arrived(Answer(key="a", text="A"))
    assert room.answers["other"][0]["ok"]


def test_too_many_clients_are_told_so(room: Room) -> None:
    for number in range(MAX_WAITING + 1):
        room.all.begin(f"client-{number}", asks(Batch((errand(f"a{number}"),), 1.0)))
    assert room.all.waiting == MAX_WAITING
    assert room.code(f"client-{MAX_WAITING}") == "busy"
    for number in range(MAX_WAITING):
        room.all.arrived(Answer(key=f"a{number}"))
    assert room.all.waiting == 0
    assert all(len(answers) == 1 for answers in room.answers.values())


def test_going_down_answers_everybody_once(room: Room, now: list[int]) -> None:
    for name in "ab":
        room.all.begin(name, asks(Batch((errand(name),), 1.0)))
    room.all.end_all("stopping", "going down")
    now[0] = 10**12
    room.all.tick()
    room.all.arrived(Answer(key="a"))
    assert {name: room.code(name) for name in "ab"} == {"a": "stopping", "b": "stopping"}
    assert len(room.post.forgotten) == 2


def test_an_order_that_takes_something_back_goes_to_a_silent_peer_and_is_not_forgotten(
    room: Room, now: list[int]
) -> None:
    room.post.away = {"label.0"}
    back = Errand("label.0", LedgerQuery(key="back"), lasting=True)
    room.all.begin("client", asks(Batch((errand("order", "label.0"), back), 1.0)))
    assert room.post.sent == [("label.0", "back")]
    now[0] = 2_000_000_000
    room.all.tick()
    assert room.answers["client"] == [{"ok": True, "told": ["label.0_down", "timeout"]}]
    assert room.post.forgotten == []
    room.all.arrived(Answer(key="back"))
    assert room.all.late == 1


def test_a_talk_may_wait_for_something_to_come_true_and_not_for_ever(room: Room, now: list[int]) -> None:
    true: list[bool] = []

    def waits() -> Talk:
        yield Batch((), 2.0, ready=lambda: bool(true))
        return {"came": bool(true)}

    room.all.begin("patient", waits())
    room.all.begin("late", waits())
    room.all.tick()
    assert room.answers == {}
    now[0] = 2_000_000_001
    room.all.tick()
    assert [answer["came"] for client in ("patient", "late") for answer in room.answers[client]] == [False, False]
    room.all.begin("lucky", waits())
    true.append(True)
    room.all.tick()
    room.all.tick()
    room.all.begin("at once", waits())
    assert [answer["came"] for client in ("lucky", "at once") for answer in room.answers[client]] == [True, True]
    assert room.all.waiting == 0
