"""What an earlier life of this process left: recordings to go on with, requests of which part may be stored already.

A label process that was killed is given again what it had not answered. The store alone knows what came of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from common import clock
from common.bus import OrderClient
from common.messages import Answer, ListOrder, SampleFilter, SampleItem, StartOrder, StopOrder
from common.messages.samples import MOST_LISTED
from services.label.recorder import Recorder
from services.label.requests import Request
from services.label.resumption import Resumption
from services.label.roster import Roster

_MOST_UNDER_WAY = 64


@dataclass(eq=False)
class _Asked:
    """A request that waits for the store's list of its samples; ``key`` of the order under way, ``due``: one is due."""

    request: Request
    key: str | None = None
    due: bool = True
    found: list[SampleItem] = field(default_factory=list)


class EarlierLife:
    """Asks the store, and holds back what can't be decided before it has said. ``name`` is this life's."""

    def __init__(self, store: OrderClient, name: str, recorder: Recorder, roster: Roster) -> None:
        self._store = store
        self._name = name
        self._recorder = recorder
        self._roster = roster
        self._born_ns = clock.monotonic_ns()
        self._resumption = Resumption(store, name)
        self._asked: list[_Asked] = []
        self._questions = 0
        self._stops: list[StopOrder] = []

    @property
    def keys(self) -> set[str]:
        """The keys of the questions under way."""
        return {self._resumption.key, *(item.key for item in self._asked if item.key is not None)}

    def store_seen(self) -> None:
        """The store is alive: ask again what it refused to say."""
        self._resumption.store_seen()
        for item in self._asked:
            item.due = item.key is None

    def hold_request(self, request: Request) -> bool:
        """Whether a new request waits for the store's word: it is older than this life, so it was sent again."""
        if not 0 < request.order.since_mono_ns < self._born_ns:
            return False
        request.held = True
        self._asked.append(_Asked(request))
        return True

    def hold_stop(self, order: StopOrder) -> bool:
        """Whether a stop waits for the recordings of the life before; a repeat takes the place of the first."""
        if self._resumption.over:
            return False
        self._stops = [item for item in self._stops if item.key != order.key] + [order]
        return True

    def answered(self, answer: Answer) -> bool:
        """Whether this was the store's answer to a question of ours."""
        if self._resumption.answered(answer):
            return True
        item = next((item for item in self._asked if item.key == answer.key), None)
        if item is None:
            return False
        item.key = None
        if answer.listed is not None:
            item.found += answer.listed.samples
            item.due = answer.listed.next_offset is not None
            if not item.due:
                item.request.resume(item.found)
        return True

    def go_on(self, look_back: Callable[[Request], None], stop: Callable[[StopOrder], None]) -> None:
        """Once a round: resume recordings; ``look_back`` and ``stop`` take what needs to wait no longer."""
        if self._roster.decided:
            self._resume()
        # The store has answered the resumption only after the samples that the life before had ordered.
        if not self._resumption.over:
            return
        for item in self._asked:
            if item.due and not item.request.answered and len(self._store.pending) < _MOST_UNDER_WAY:
                self._ask(item)
        free = [item.request for item in self._asked if not item.request.held]
        self._asked = [item for item in self._asked if item.request.held and not item.request.answered]
        for request in free:
            look_back(request)
        for order in self.give_up():
            stop(order)

    def give_up(self) -> list[StopOrder]:
        """The stops that waited; they wait no longer."""
        stops, self._stops = self._stops, []
        return stops

    def _resume(self) -> None:
        for ledger in self._resumption.take():
            for camera, account in ledger.cameras.items():
                if ledger.phase == "running" and self._roster.may_serve(camera):
                    order = StartOrder(key=f"resume/{ledger.spec.recording}", spec=ledger.spec, camera=camera)
                    self._recorder.start(order, resumed=account)

    def _ask(self, item: _Asked) -> None:
        self._questions += 1
        item.due = False
        item.key = f"list/{self._name}/{self._questions}"
        order = item.request.order
        wanted = SampleFilter(recording=order.recording, camera=order.camera)
        self._store.send(ListOrder(key=item.key, filter=wanted, offset=len(item.found), limit=MOST_LISTED))
