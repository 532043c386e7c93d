"""Store orders between arrival and answer: each is carried out once, whoever repeats it gets the same answer. Pure."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

from common.bus import Return
from common.ids import is_sample_name, sample_camera
from common.messages import Answer, ErrorInfo, LedgerQuery, StoreOrder
from services.store.sample import BAD_SAMPLE

_MOST_REMEMBERED = 4096

_Pixels = tuple[str, str, int]


@dataclass(frozen=True, slots=True)
class _Held:
    return_: Return
    query: LedgerQuery
    waits_for: set[str]


class StoreOrders:
    """The table of store orders.

    Refusals are remembered for the very pixels they were about: a late repeat of a refused order must not be
    carried out, since its sender has given the slot to another sample by then.
    """

    def __init__(self) -> None:
        self._waiting: dict[str, list[Return]] = {}
        self._refused: OrderedDict[_Pixels, Answer] = OrderedDict()
        self._held: list[_Held] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def join(self, return_: Return, order: StoreOrder) -> bool:
        """Whether the order is in work already; its answer then goes to everyone who asked."""
        waiting = self._waiting.get(order.key)
        if waiting is None:
            return False
        if return_ not in waiting:
            waiting.append(return_)
        return True

    def refusal(self, order: StoreOrder) -> Answer | None:
        """The refusal that this very order got before."""
        return self._refused.get(_pixels(order))

    def begin(self, return_: Return, order: StoreOrder) -> None:
        """The order is in work from now on."""
        self._waiting[order.key] = [return_]

    def hold(self, return_: Return, query: LedgerQuery) -> bool:
        """Keep a query until the orders that are in work now are finished; False if none is."""
        if self._waiting:
            self._held.append(_Held(return_, query, set(self._waiting)))
        return bool(self._waiting)

    def due(self) -> list[tuple[Return, LedgerQuery]]:
        """The queries whose time has come, each once."""
        done = [held for held in self._held if not held.waits_for]
        if done:
            self._held = [held for held in self._held if held.waits_for]
        return [(held.return_, held.query) for held in done]

    def finish(self, order: StoreOrder, answer: Answer) -> list[Return]:
        """The order has its answer; returns to whom it goes."""
        if answer.error is not None:
            self._refused[_pixels(order)] = answer
            if len(self._refused) > _MOST_REMEMBERED:
                self._refused.popitem(last=False)
        for held in self._held:
            held.waits_for.discard(order.key)
        return self._waiting.pop(order.key, [])


def fault(order: StoreOrder) -> ErrorInfo | None:
    """What is wrong with an order in itself; its key becomes part of file names, so it must be a sample name."""
    if not is_sample_name(order.key) or order.label.sample != order.key:
        reason = f"'{order.key[:80]}' is not the name of the sample in its label, or no sample name at all"
    elif order.camera != sample_camera(order.key) or order.label.camera.name != order.camera:
        reason = f"sample {order.key} is not one of camera {order.camera}"
    elif order.label.recording != order.recording:
        reason = f"the label of {order.key} names another recording than its order"
    else:
        return None
    return ErrorInfo(code=BAD_SAMPLE, message=f"{reason}; this is a bug in the label service")


def _pixels(order: StoreOrder) -> _Pixels:
    return order.key, order.ring, order.slot
