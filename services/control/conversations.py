"""The clients' requests in progress: each is a generator that yields the orders it needs answers to.

A handler reads from top to bottom (`answers = yield Batch(...)`), yet nothing here waits: the loop goes on, and a
generator is resumed when all answers to its batch are there or the batch's time is up. What it returns is the
client's answer; a TagmillError that leaves it is the client's refusal. So each client gets exactly one answer.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Generator, Hashable
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

from common import clock
from common.errors import ConfigError, RefusedError, TagmillError
from common.log import get
from common.messages import Answer, ErrorInfo, Order

Plain = dict[str, Any]
Client = TypeVar("Client", bound=Hashable)

MAX_WAITING = 4096
"""Clients that may wait at a time; further ones are refused as ``busy``."""


@dataclass(frozen=True, slots=True)
class Errand:
    """An order and whom it is for: ``store`` or ``label.N``.

    A ``lasting`` one takes something back: it goes to a silent peer too, and is not forgotten when its time is up.
    """

    peer: str
    order: Order
    lasting: bool = False


@dataclass(frozen=True, slots=True)
class Batch:
    """Errands at once; their answers come back in the same order, each with an error where nothing came in time.

    With ``ready`` it is also waited for that to come true, or for the time to be up.
    """

    errands: tuple[Errand, ...]
    timeout_s: float
    ready: Callable[[], bool] | None = None


Answers = tuple[Answer, ...]
Talk = Generator[Batch, Answers, Plain]


class Messenger(Protocol):
    """Whoever carries orders (`Peers`)."""

    def send(self, peer: str, order: Order, *, lasting: bool = False) -> None:
        """Send, or raise RefusedError; a ``lasting`` order as soon as that is possible."""

    def forget(self, peer: str, key: str) -> None:
        """No answer to this order is wanted any more."""


class Keys:
    """Keys of orders; the boot id tells those of another life of control apart."""

    def __init__(self, boot: str) -> None:
        self._boot = boot
        self._numbers = itertools.count(1)

    def new(self, what: str) -> str:
        """A key that was never used."""
        return f"{what}/{self._boot}/{next(self._numbers)}"


@dataclass(eq=False, slots=True)
class _Waiting(Generic[Client]):
    client: Client
    talk: Talk
    batch: Batch = Batch((), 0.0)
    answers: dict[str, Answer] = field(default_factory=dict)

    @property
    def complete(self) -> bool:
        ready = self.batch.ready
        return len(self.answers) == len(self.batch.errands) and (ready is None or ready())


class Conversations(Generic[Client]):
    """All conversations under way. ``answered`` counts the answers that were given, ``late`` orders' late answers."""

    def __init__(self, messenger: Messenger, reply: Callable[[Client, Plain], None]) -> None:
        self.answered = 0
        self.late = 0
        self.bugs = 0
        self._messenger = messenger
        self._reply = reply
        self._open: set[_Waiting[Client]] = set()
        self._watching: set[_Waiting[Client]] = set()
        self._by_key: dict[str, _Waiting[Client]] = {}
        self._deadlines: list[tuple[int, int, _Waiting[Client], Batch]] = []
        self._tie = itertools.count()

    @property
    def waiting(self) -> int:
        """Clients that have no answer yet."""
        return len(self._open)

    def begin(self, client: Client, talk: Talk) -> None:
        """Start a conversation; it may end at once."""
        if len(self._open) >= MAX_WAITING:
            talk.close()
            self._finish(client, refusal("busy", f"{MAX_WAITING} requests are waiting already; ask again later"))
            return
        waiting = _Waiting(client, talk)
        self._open.add(waiting)
        self._resume(waiting, None)

    def arrived(self, answer: Answer) -> None:
        """A peer answered an order."""
        waiting = self._by_key.pop(answer.key, None)
        if waiting is None:
            self.late += 1
            return
        waiting.answers[answer.key] = answer
        if waiting.complete:
            self._resume(waiting, self._collected(waiting))

    def tick(self) -> None:
        """Resume those whose time is up (orders without an answer get the error ``timeout``) or who are ready."""
        for waiting in [item for item in self._watching if item.complete]:
            self._watching.discard(waiting)
            self._resume(waiting, self._collected(waiting))
        now = clock.monotonic_ns()
        while self._deadlines and self._deadlines[0][0] <= now:
            _, _, waiting, batch = heapq.heappop(self._deadlines)
            if waiting in self._open and waiting.batch is batch:
                self._give_up(waiting)

    def end_all(self, code: str, message: str) -> None:
        """Refuse everybody who waits (control is going down)."""
        for waiting in list(self._open):
            self._clear(waiting)
            waiting.talk.close()
            self._open.discard(waiting)
            self._finish(waiting.client, refusal(code, message))

    def _resume(self, waiting: _Waiting[Client], answers: Answers | None) -> None:
        """Run the talk to its next batch that has to wait, or to its end."""
        while True:
            try:
                batch = next(waiting.talk) if answers is None else waiting.talk.send(answers)
            except StopIteration as end:
                return self._end(waiting, {"ok": True} | end.value)
            except TagmillError as error:
                return self._end(waiting, refusal_of(error))
            except Exception as error:  # noqa: BLE001 - a bug in one command is logged and costs that command only
                self.bugs += 1
                get().exception("command.failed")
                return self._end(waiting, refusal("failed", f"a mistake in tagmill itself: {error!r}; see the log"))
            waiting.batch, waiting.answers = batch, {}
            self._send(waiting)
            if not waiting.complete:
                deadline = clock.monotonic_ns() + int(batch.timeout_s * 1e9)
                heapq.heappush(self._deadlines, (deadline, next(self._tie), waiting, batch))
                if batch.ready is not None:
                    self._watching.add(waiting)
                return None
            answers = self._collected(waiting)

    def _send(self, waiting: _Waiting[Client]) -> None:
        for errand in waiting.batch.errands:
            key = errand.order.key
            try:
                self._messenger.send(errand.peer, errand.order, lasting=errand.lasting)
            except RefusedError as error:
                waiting.answers[key] = Answer(key=key, error=ErrorInfo(code=error.code, message=error.message))
            else:
                self._by_key[key] = waiting

    def _give_up(self, waiting: _Waiting[Client]) -> None:
        self._clear(waiting)
        for errand in waiting.batch.errands:
            key = errand.order.key
            if key not in waiting.answers:
                waiting.answers[key] = Answer(key=key, error=_no_answer(errand, waiting.batch.timeout_s))
        self._resume(waiting, self._collected(waiting))

    def _clear(self, waiting: _Waiting[Client]) -> None:
        """Forget the orders that have no answer, so that none is carried out long after its client was told.

        Lasting ones stay with the messenger; their answers come late.
        """
        self._watching.discard(waiting)
        for errand in waiting.batch.errands:
            if self._by_key.pop(errand.order.key, None) is not None and not errand.lasting:
                self._messenger.forget(errand.peer, errand.order.key)

    @staticmethod
    def _collected(waiting: _Waiting[Client]) -> Answers:
        return tuple(waiting.answers[errand.order.key] for errand in waiting.batch.errands)

    def _end(self, waiting: _Waiting[Client], answer: Plain) -> None:
        self._open.discard(waiting)
        self._watching.discard(waiting)
        self._finish(waiting.client, answer)

    def _finish(self, client: Client, answer: Plain) -> None:
        self.answered += 1
        self._reply(client, answer)


def refusal(code: str, message: str, **more: Any) -> Plain:
    """An answer that says no."""
    return {"ok": False, "error": {"code": code, "message": message}} | more


def refusal_of(error: TagmillError) -> Plain:
    """The refusal for an expected error; a ConfigError's mistakes go along."""
    more = {"problems": list(error.problems)} if isinstance(error, ConfigError) else {}
    return refusal(error.code, error.message, **more)


def _no_answer(errand: Errand, timeout_s: float) -> ErrorInfo:
    return ErrorInfo(
        code="timeout",
        message=f"{errand.peer} has not answered within {timeout_s:g} s; see 'tagmill status' for how it is",
    )
