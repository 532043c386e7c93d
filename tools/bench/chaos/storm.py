"""Lets the faults of a plan happen, several at a time, and sees that the stack comes back in between."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack

from common.bus import CommandClient, Poller
from common.clock import monotonic_ns
from common.errors import TagmillError
from tools.bench.chaos.client import Clients, Journal
from tools.bench.chaos.faults import CAUSES, EVERYTHING, Context
from tools.bench.chaos.plan import Fault
from tools.bench.chaos.stack import Stack, until

BREATHE_EVERY = 10
_RECORD_S = 30.0
_COMES_BACK_S = 600.0


class Storm:
    """Faults that hold one thing come one after the other; any others overlap as their plan has it."""

    def __init__(self, stack: Stack, journal: Journal, tell: Callable[[str], None]) -> None:
        self._stack, self._journal, self._tell = stack, journal, tell
        self._active: list[tuple[int, str, ExitStack]] = []
        self.done = 0
        self.left_out = 0

    def run(self, plan: Iterable[Fault], clients: Clients, limit_s: float) -> None:
        """All of them, or as many as begin within the limit; raises TagmillError if the stack doesn't come back."""
        deadline_ns = monotonic_ns() + limit_s * 1e9
        try:
            for fault in plan:
                if monotonic_ns() > deadline_ns:
                    return
                self._pause(fault.gap_s)
                self._happen(fault)
                if (fault.number + 1) % BREATHE_EVERY == 0:
                    clients.quiet.set()
                    self._breathe(fault.number)
                    clients.quiet.clear()
        finally:
            self._end_all()

    def _happen(self, fault: Fault) -> None:
        cause = CAUSES[fault.kind]
        if cause.needs_mounts and not self._stack.ground.mounted:
            self.left_out += 1
            return
        holds = cause.holds or fault.target
        if holds == EVERYTHING:
            self._end_all()
        while any(other == holds for _, other, _ in self._active):
            self._end_first(holds)
        self._tell(f"{fault.number + 1:4} {fault.kind}: {fault.target}")
        self._journal.write(fault=fault.number, kind=fault.kind, target=fault.target)
        self._begin(cause.make(self._stack, fault), holds, fault.lasts_s)
        self.done += 1

    def _begin(self, context: Context, holds: str, lasts_s: float) -> None:
        effects = ExitStack()
        effects.enter_context(context)
        self._active.append((monotonic_ns() + int(lasts_s * 1e9), holds, effects))
        self._active.sort(key=lambda one: one[0])

    def _pause(self, seconds: float) -> None:
        """Wait, and end what is due meanwhile."""
        until_ns, pause = monotonic_ns() + int(seconds * 1e9), Poller()
        while True:
            now = monotonic_ns()
            while self._active and self._active[0][0] <= now:
                self._active.pop(0)[2].close()
            if now >= until_ns:
                return
            due = min([until_ns, *(end for end, _, _ in self._active)])
            pause.wait(max(due - now, 0) / 1e9)

    def _end_first(self, holds: str) -> None:
        """Wait for the end of what holds this."""
        due = next(end for end, other, _ in self._active if other == holds)
        self._pause(max(due - monotonic_ns(), 0) / 1e9)

    def _end_all(self) -> None:
        try:
            while self._active:
                self._pause(max(self._active[-1][0] - monotonic_ns(), 0) / 1e9)
        finally:
            for _, _, effects in self._active:
                effects.close()
            self._active = []

    def _breathe(self, number: int) -> None:
        """No fault for a moment: the stack must be whole again and record."""
        self._end_all()
        try:
            self._stack.wait_ready()
            self.record()
        except TagmillError as error:
            self._journal.write(not_recovered=error.message, after=number)
            raise

    def record(self, count: int = 1) -> None:
        """End all recordings, then samples of each camera; raises TagmillError if they aren't to be had."""
        request = {"command": "record", "camera": "all", "count": count, "interval_s": 0.2, "timeout_s": _RECORD_S}
        refused = ""
        with CommandClient(self._stack.endpoints) as client:
            self._journal.ask(client, {"command": "stop"}, 4 * _RECORD_S)

            def recorded() -> bool | None:
                nonlocal refused
                answer = self._journal.ask(client, request, 2 * _RECORD_S)
                refused = "no answer" if answer is None else str(answer.get("error"))
                return True if answer is not None and answer["ok"] else None

            try:
                until(recorded, _COMES_BACK_S, "a sample of each camera")
            except TagmillError as error:
                raise TagmillError(f"{error.message}: {refused}") from error
