"""What becomes of orders that the life before of a label process was given: it asks the store, and does what lacks."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from common import clock
from common.bus import Endpoints, OrderClient, OrderServer, Poller, Return
from common.config.models import NetworkConfig
from common.ids import sample_name
from common.ledgers import CameraLedger, Ledger, RecordingSpec
from common.log import get
from common.messages import (
    Answer,
    ErrorInfo,
    ListOrder,
    Order,
    RecordOrder,
    SampleItem,
    SampleList,
    StopOrder,
    StoreSideOrder,
)
from services.label.earlier_life import EarlierLife
from services.label.recorder import Recorder
from services.label.requests import Request
from services.label.roster import Roster
from tests.support.stack import wait_for
from tests.unit.services.label.test_recorder import detections, seen

SECOND = 1_000_000_000


def sample(age_s: float) -> SampleItem:
    wall = clock.wall_ns() - int(age_s * 1e9)
    return SampleItem(
        name=sample_name(wall, "cam0", 7),
        captured_at=clock.iso_utc(wall),
        camera="cam0",
        frame=7,
        recording="rec-1",
        complete=True,
        background=False,
        objects=(),
        files={},
    )


class Bench:
    """A recorder, and a store whose answers the test gives over the real order sockets."""

    def __init__(self) -> None:
        endpoints = Endpoints.of(NetworkConfig())
        endpoints.prepare()
        self.store = OrderServer(endpoints.orders_store, StoreSideOrder, "store")
        self.client = OrderClient(endpoints.orders_store, "label.0")
        self.client.peer_seen("store-1")
        self.answers: list[Answer] = []
        self.stopped: list[StopOrder] = []
        self.looked_back: list[Request] = []
        self.recorder = Recorder(self.answers.append)
        self.earlier = EarlierLife(self.client, "label.0/b", self.recorder, Roster(0, 1, 12, get()))
        self.poller = Poller(self.store, self.client)

    def close(self) -> None:
        self.client.close()
        self.store.close()

    def asked(self) -> tuple[Return, Order]:
        """The next question, however long its way is."""
        came: list[tuple[Return, Order]] = []

        def look() -> bool:
            self.poller.wait(0.05)
            self.client.peer_seen("store-1")  # the store's heartbeat: what couldn't be sent before goes now
            came.extend(self.store.receive())
            return bool(came)

        wait_for(look, 30.0, "a question to the store")
        (only,) = came
        return only

    def nothing_asked(self) -> bool:
        self.poller.wait(0.1)
        return not self.store.receive()

    def tell(self, to: Return, answer: Answer) -> None:
        self.store.answer(to, answer)

        def heard() -> bool:
            self.poller.wait(0.05)
            return sum(self.earlier.answered(item) for item in self.client.receive()) > 0

        wait_for(heard, 30.0, "the store's answer")
        self.go_on()

    def go_on(self) -> None:
        self.earlier.go_on(self.looked_back.append, self.stopped.append)

    def tell_recordings(self, *ledgers: Ledger) -> None:
        to, order = self.asked()
        self.tell(to, Answer(key=order.key, ledgers=ledgers))

    def tell_samples(self, *items: SampleItem, next_offset: int | None = None) -> ListOrder:
        to, order = self.asked()
        assert isinstance(order, ListOrder)
        listed = SampleList(
            session="s", samples=items, total=len(items), stored=len(items), in_bin=0, next_offset=next_offset
        )
        self.tell(to, Answer(key=order.key, listed=listed))
        return order

    def record(self, *, age_s: float = 10.0, **more: float) -> Request:
        given_ns = clock.monotonic_ns() - int(age_s * 1e9)
        order = RecordOrder(
            key="k", recording="rec-1", camera="cam0", timeout_s=60, since_mono_ns=given_ns, count=3
        ).model_copy(update=more)
        request = self.recorder.record(order)
        assert request is not None
        return request

    def frame(self, number: int) -> list[str]:
        """A frame with an object; the samples that were begun with it."""
        begun: list[str] = []

        def begin(*_: object) -> str:
            begun.append(f"s{number}")
            return begun[-1]

        self.recorder.frame(detections(number), seen(objects=1), begin)
        return begun


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()


def test_a_request_of_this_life_waits_for_nobody(bench: Bench) -> None:
    request = bench.record(age_s=-0.1)
    assert not bench.earlier.hold_request(request)
    assert bench.frame(1) == []  # it was captured before the order
    assert not request.held


def test_a_request_that_was_sent_again_takes_only_what_the_life_before_did_not_store(bench: Bench) -> None:
    request = bench.record()
    assert bench.earlier.hold_request(request)
    assert bench.frame(1) == [], "it must not take a frame before the store has said what it has"
    bench.tell_recordings()
    stored = [sample(8), sample(6)]
    order = bench.tell_samples(*stored)
    assert (order.filter.recording, order.filter.camera, order.session) == ("rec-1", "cam0", None)
    assert bench.looked_back == [request]
    assert sorted(request.samples) == sorted(item.name for item in stored)
    assert bench.recorder.record(request.order) is None, "control repeats an order that it waits for long"
    assert bench.frame(2) == ["s2"]
    request.stored("s2")
    bench.recorder.tick({})
    (answer,) = bench.answers
    assert answer.error is None
    assert len(answer.samples) == len(set(answer.samples)) == 3
    account = request.account.ledger()
    assert account.recorded == 3
    assert account.captured == account.recorded + sum(account.refused.values())


def test_a_request_whose_samples_are_all_stored_is_answered_with_them(bench: Bench) -> None:
    request = bench.record()
    bench.earlier.hold_request(request)
    bench.tell_recordings()
    bench.tell_samples(sample(3), sample(2), next_offset=2)
    assert request.held
    assert bench.tell_samples(sample(1)).offset == 2
    bench.recorder.tick({})
    assert [len(answer.samples) for answer in bench.answers] == [3]
    assert bench.frame(1) == []


def test_the_interval_runs_on_from_the_last_stored_sample(bench: Bench) -> None:
    request = bench.record(interval_s=20.0)
    bench.earlier.hold_request(request)
    bench.tell_recordings()
    bench.tell_samples(sample(5))
    left_s = (request.next_due_ns - clock.monotonic_ns()) / SECOND
    assert 0 < left_s <= 15
    assert bench.frame(1) == []


def test_a_store_that_refuses_is_asked_again_at_its_next_sign_of_life(bench: Bench) -> None:
    request = bench.record()
    bench.earlier.hold_request(request)
    bench.tell_recordings()
    to, order = bench.asked()
    bench.tell(to, Answer(key=order.key, error=ErrorInfo(code="disk_gone", message="the disk is gone")))
    bench.go_on()
    assert bench.nothing_asked()
    assert request.held
    bench.earlier.store_seen()
    bench.go_on()
    bench.tell_samples()
    assert not request.held


def test_while_the_store_says_nothing_the_request_is_refused_at_its_deadline(bench: Bench) -> None:
    request = bench.record(timeout_s=0.001)
    assert bench.earlier.hold_request(request)
    bench.recorder.tick({})
    (answer,) = bench.answers
    assert answer.error is not None
    assert answer.error.code == "store_down"


def test_a_stop_waits_until_it_is_known_what_ran(bench: Bench) -> None:
    stop = StopOrder(key="stop", recording="rec-2", camera="cam0")
    assert bench.earlier.hold_stop(stop)
    assert bench.earlier.hold_stop(stop), "a repeat"
    bench.go_on()
    assert bench.stopped == []
    spec = RecordingSpec(recording="rec-2", mode="all", cameras=("cam0",), started_at="now")
    bench.tell_recordings(Ledger(spec=spec, phase="running", cameras={"cam0": CameraLedger(captured=4, recorded=4)}))
    assert bench.stopped == [stop]
    assert bench.recorder.stop("rec-2", "cam0", "stop"), "the recording goes on before its stop is carried out"
    assert not bench.earlier.hold_stop(stop), "from now on what is not known is not known"


def test_stops_that_wait_are_handed_back_at_the_end(bench: Bench) -> None:
    stop = StopOrder(key="stop", recording="rec-2", camera="cam0")
    bench.earlier.hold_stop(stop)
    assert bench.earlier.give_up() == [stop]
    assert bench.earlier.give_up() == []
