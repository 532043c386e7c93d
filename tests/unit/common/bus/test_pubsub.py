"""Publisher, proxy and subscriber together."""

from __future__ import annotations

import itertools
import signal
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import psutil
import pytest
import zmq
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from structlog.testing import capture_logs

from common import clock
from common.bus import Endpoints, Proxy, Subscriber
from common.errors import CodecError, NameTakenError
from common.labels import DetectedWindow, Window
from common.messages import (
    MAX_BYTES,
    Detections,
    FrameAnnounced,
    FrameRef,
    Message,
    Preview,
    ServiceState,
    Stamp,
    encode,
)
from common.topics import DETECTIONS, FRAME, PREVIEW, SERVICE
from tests.support.bus import Bus, collect
from tests.support.stack import Stack, wait_for, write_rig

_BOOTS = (f"r{number}" for number in itertools.count())


def frame(number: int, camera: str = "cam0") -> FrameAnnounced:
    return FrameAnnounced(ref=ref(number, camera))


def ref(number: int, camera: str = "cam0") -> FrameRef:
    return FrameRef(
        camera=camera, boot="b", ring="r", frame=number, count=number, captured_mono_ns=1, captured_wall_ns=1
    )


def seen(number: int, camera: str = "cam0") -> Detections:
    return Detections(ref=ref(number, camera))


def stamped(message: Message, seq: int = 1) -> bytes:
    now = clock.monotonic_ns()
    return encode(message.stamped(Stamp(source="raw", boot="r", seq=seq, mono_ns=now, wall_ns=now)))


def number_of(message: Message) -> int:
    assert isinstance(message, FrameAnnounced | Detections)
    return message.ref.frame


@pytest.fixture
def raw(endpoints: Endpoints) -> Iterator[zmq.Socket[bytes]]:
    """Somebody who sends what he likes straight into the bus."""
    made = zmq.Context.instance().socket(zmq.PUB)
    made.linger = 0
    made.sndhwm = 0
    made.connect(endpoints.publish)
    yield made
    made.close()


def test_every_message_of_an_every_topic_comes_in_order(bus: Bus, proxy: Proxy) -> None:
    publisher, subscriber = bus.publisher(), bus.subscriber(DETECTIONS)
    bus.connect(publisher, subscriber)
    for number in range(20):
        publisher.publish(DETECTIONS, ("cam0", "markers"), seen(number))
    got = collect(subscriber, 20)
    assert [number_of(received.message) for received in got] == list(range(20))
    assert got[0].topic is DETECTIONS
    assert got[0].keys == ("cam0", "markers")
    assert [received.stamp.seq for received in got] == list(range(1, 21))
    assert {received.stamp.source for received in got} == {"test"}
    assert 0 <= got[0].age_ns < 20e9
    assert (subscriber.bad, subscriber.missed, subscriber.superseded) == (0, {}, {})


def test_who_wants_every_message_of_a_latest_topic_gets_them(bus: Bus, proxy: Proxy) -> None:
    publisher, subscriber = bus.publisher(), bus.subscriber(FRAME)
    subscriber.subscribe(FRAME, every=True)
    bus.connect(publisher, subscriber)
    for number in range(1, 21):
        publisher.publish(FRAME, ("cam0",), frame(number))
    got = collect(subscriber, 20)
    assert [number_of(received.message) for received in got] == list(range(1, 21))
    assert (subscriber.bad, subscriber.missed, subscriber.superseded) == (0, {}, {})


def test_of_a_latest_topic_only_the_newest_of_each_key_comes(bus: Bus, proxy: Proxy) -> None:
    publisher, subscriber = bus.publisher(), bus.subscriber(FRAME)
    bus.connect(publisher, subscriber)
    for camera in ("cam0", "cam1"):
        publisher.publish(FRAME, (camera,), frame(1, camera))
    got = collect(subscriber, 2)
    for number in range(2, 502):
        publisher.publish(FRAME, ("cam0",), frame(number))
        publisher.publish(FRAME, ("cam1",), frame(number, "cam1"))

    def up_to_date() -> bool:
        batch = subscriber.receive()
        assert len({received.keys for received in batch}) == len(batch), "more than the newest of a key"
        got.extend(batch)
        # The very last may be lost in a full queue: repeat until the reader has both.
        for camera in ("cam0", "cam1"):
            publisher.publish(FRAME, (camera,), frame(502, camera))
        return {received.keys[0] for received in got if number_of(received.message) == 502} == {"cam0", "cam1"}

    wait_for(up_to_date, 20, "the newest of both cameras")
    assert subscriber.superseded["frame"] > 0
    lost = subscriber.superseded["frame"] + subscriber.missed.get("frame", 0)
    last = {received.keys: received.stamp.seq for received in got}
    assert len(got) + lost == sum(last.values())
    for camera in ("cam0", "cam1"):
        numbers = [number_of(received.message) for received in got if received.keys == (camera,)]
        assert numbers == sorted(numbers)


def test_a_key_does_not_match_a_longer_one(bus: Bus, proxy: Proxy) -> None:
    publisher, subscriber = bus.publisher(), bus.subscriber()
    subscriber.subscribe(FRAME, "cam1")
    bus.connect(publisher, subscriber)
    publisher.publish(FRAME, ("cam10",), frame(1, "cam10"))
    publisher.publish(FRAME, ("cam1",), frame(2, "cam1"))
    assert [received.keys for received in collect(subscriber, 1)] == [("cam1",)]
    assert subscriber.bad == 0


def test_unsubscribed_is_unsubscribed(bus: Bus, proxy: Proxy) -> None:
    publisher, subscriber = bus.publisher(), bus.subscriber(FRAME, DETECTIONS)
    bus.connect(publisher, subscriber)
    subscriber.unsubscribe(FRAME)
    subscriber.unsubscribe(FRAME)
    bus.connect(publisher, subscriber)  # the proxy has taken the change
    publisher.publish(FRAME, ("cam0",), frame(1))
    publisher.publish(DETECTIONS, ("cam0", "markers"), seen(2))
    assert [received.topic for received in collect(subscriber, 1)] == [DETECTIONS]


def test_a_message_of_another_topic_is_a_bug(bus: Bus) -> None:
    publisher = bus.publisher()
    with pytest.raises(TypeError, match="takes FrameAnnounced"):
        publisher.publish(FRAME, ("cam0",), seen(1))
    with pytest.raises(ValueError, match="needs names"):
        publisher.publish(DETECTIONS, ("cam0",), seen(1))
    with pytest.raises(ValueError, match="needs names"):
        publisher.publish(FRAME, ("cam/0",), frame(1))


def test_a_message_too_large_is_refused_before_it_leaves(bus: Bus) -> None:
    window = DetectedWindow(**{"class": "x" * 1000}, score=1.0, window=Window(x_min=0, y_min=0, x_max=1, y_max=1))
    large = Detections(ref=ref(1), windows=(window,) * 1100)
    with pytest.raises(CodecError, match="larger than"):
        bus.publisher().publish(DETECTIONS, ("cam0", "markers"), large)


def test_ten_thousand_messages_come_through_in_order(bus: Bus, proxy: Proxy) -> None:
    publisher, subscriber = bus.publisher(), bus.subscriber(DETECTIONS)
    bus.connect(publisher, subscriber)
    expected = 0
    for burst in range(1000):
        for number in range(burst * 10, burst * 10 + 10):
            publisher.publish(DETECTIONS, ("cam0", "markers"), seen(number))
        for received in collect(subscriber, 10):
            assert number_of(received.message) == expected
            expected += 1
    assert expected == 10_000
    assert (publisher.dropped, subscriber.missed, subscriber.bad) == (0, {}, 0)


def test_what_a_slow_reader_loses_is_counted_by_it(bus: Bus, proxy: Proxy) -> None:
    publisher, subscriber = bus.publisher(), bus.subscriber(DETECTIONS)
    bus.connect(publisher, subscriber)
    sent = 3000
    for number in range(sent):
        publisher.publish(DETECTIONS, ("cam0", "markers"), seen(number))
    got = collect(subscriber, 50)

    def marked() -> bool:
        publisher.publish(DETECTIONS, ("cam0", "markers"), seen(1_000_000))
        got.extend(collect(subscriber, 1))
        return number_of(got[-1].message) == 1_000_000

    wait_for(marked, 20, "the mark")
    assert len(got) + subscriber.missed.get("detections", 0) == got[-1].stamp.seq
    numbers = [number_of(received.message) for received in got]
    assert numbers == sorted(numbers)


def test_a_flood_of_previews_crowds_out_nothing(bus: Bus, proxy: Proxy) -> None:
    publisher, subscriber = bus.publisher(), bus.subscriber(DETECTIONS, PREVIEW)
    bus.connect(publisher, subscriber)

    def preview_came() -> bool:
        publisher.publish(PREVIEW, ("cam0",), Preview(shown=ref(1), of=ref(1)))
        return any(received.topic is PREVIEW for received in subscriber.receive())

    wait_for(preview_came, 20, "a preview")
    for number in range(20):
        for _ in range(50):
            publisher.publish(PREVIEW, ("cam0",), Preview(shown=ref(number), of=ref(number)))
        publisher.publish(DETECTIONS, ("cam0", "markers"), seen(number))
    got = []

    def all_came() -> bool:
        got.extend(received for received in subscriber.receive() if received.topic is DETECTIONS)
        return len(got) == 20

    wait_for(all_came, 20, "20 detections")
    assert subscriber.missed.get("detections", 0) == 0


def test_a_second_proxy_is_refused_and_steals_nothing(bus: Bus, proxy: Proxy) -> None:
    publisher, subscriber = bus.publisher(), bus.subscriber(DETECTIONS)
    bus.connect(publisher, subscriber)
    with pytest.raises(NameTakenError, match="held by the bus proxy"):
        Proxy(bus.endpoints).start()
    with closing(Subscriber(bus.endpoints)) as newcomer:
        bus.connect(publisher, newcomer)  # the old proxy still takes connections
    publisher.publish(DETECTIONS, ("cam0", "markers"), seen(1))
    assert len(collect(subscriber, 1)) == 1


def test_a_closed_proxy_leaves_nothing_and_can_be_followed(bus: Bus, proxy: Proxy) -> None:
    publisher, subscriber = bus.publisher(), bus.subscriber(DETECTIONS)
    bus.connect(publisher, subscriber)
    for _ in range(5):
        proxy.close()
        proxy.close()
        assert list(bus.endpoints.run_dir.iterdir()) == []
        proxy.start()
        bus.connect(publisher, subscriber)


@pytest.mark.process
def test_old_news_after_an_outage_is_told_by_its_age(stack: Stack, bus: Bus, tmp_path: Path) -> None:
    rig = write_rig(tmp_path)
    process = stack.start_module("tests.support.bus_only", "--rig", str(rig))
    publisher, subscriber = bus.publisher(), bus.subscriber(DETECTIONS)
    bus.connect(publisher, subscriber)
    publisher.publish(DETECTIONS, ("cam0", "markers"), seen(0))
    assert len(collect(subscriber, 1)) == 1
    process.kill()
    for number in range(100):
        publisher.publish(DETECTIONS, ("cam0", "markers"), seen(number))
    began = clock.monotonic_ns()
    wait_for(lambda: clock.monotonic_ns() - began > 300_000_000, 5, "an outage of 0.3 s")
    stack.start_module("tests.support.bus_only", "--rig", str(rig))
    fresh = []

    def fresh_came() -> bool:
        publisher.publish(DETECTIONS, ("cam0", "markers"), seen(1000))
        subscriber.sockets[0].poll(20)
        fresh.extend(subscriber.receive(max_age_s=0.2))
        return bool(fresh)

    wait_for(fresh_came, 20, "fresh news")
    assert {number_of(received.message) for received in fresh} == {1000}
    lost = subscriber.stale.get("detections", 0) + subscriber.missed.get("detections", 0)
    assert lost == fresh[-1].stamp.seq - 1 - len(fresh)
    assert lost >= 100


@pytest.mark.process
def test_a_stopped_proxy_blocks_no_publisher(stack: Stack, bus: Bus, tmp_path: Path) -> None:
    process = stack.start_module("tests.support.bus_only", "--rig", str(write_rig(tmp_path)))
    publisher, subscriber = bus.publisher(), bus.subscriber(DETECTIONS)
    bus.connect(publisher, subscriber)
    process.send_signal(signal.SIGSTOP)
    wait_for(lambda: psutil.Process(process.pid).status() == psutil.STATUS_STOPPED, 5, "the stop")
    for number in range(5000):
        publisher.publish(DETECTIONS, ("cam0", "markers"), seen(number))
    assert publisher.dropped > 0
    process.send_signal(signal.SIGCONT)
    bus.connect(publisher, subscriber)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    garbage=st.one_of(
        st.binary(max_size=300).map(lambda tail: [b"detections/cam0/markers", tail]),
        st.binary(max_size=40).map(lambda tail: [b"frame/\xff" + tail, stamped(frame(1))]),
        st.lists(st.binary(max_size=40), max_size=4).map(lambda tail: [b"service/x", *tail]),
        st.integers(1, 180).map(lambda cut: [b"frame/cam0", stamped(frame(1))[:-cut]]),
        st.binary(max_size=60).map(lambda name: [b"frame" + name, b""]),
        st.just([b"frame/cam0", encode(frame(1))]),
    )
)
def test_garbage_on_the_bus_changes_nothing(
    bus: Bus, proxy: Proxy, raw: zmq.Socket[bytes], garbage: list[bytes]
) -> None:
    subscriber = bus.subscriber(DETECTIONS, FRAME, SERVICE)
    with closing(subscriber):
        _through(raw, subscriber, [])
        _through(raw, subscriber, garbage)


def _through(raw: zmq.Socket[bytes], subscriber: Subscriber, garbage: list[bytes]) -> None:
    """Send ``garbage`` and then valid messages of this call until one arrives; nothing else may."""
    if garbage:
        raw.send_multipart(garbage)
    boot = next(_BOOTS)
    state = ServiceState(service="raw", boot=boot, pid=1, phase="running")

    def valid_came() -> bool:
        raw.send_multipart([b"service/raw", stamped(state)])
        subscriber.sockets[0].poll(20)
        got = subscriber.receive()
        assert {received.keys for received in got} <= {("raw",)}
        # One that an earlier call sent may still have been on its way, ahead of the garbage.
        return any(isinstance(item.message, ServiceState) and item.message.boot == boot for item in got)

    wait_for(valid_came, 20, "a valid message")


def test_garbage_is_counted_and_logged_once_a_kind(bus: Bus, proxy: Proxy, raw: zmq.Socket[bytes]) -> None:
    subscriber = bus.subscriber(FRAME, SERVICE)
    _through(raw, subscriber, [])
    wrong_version = frame(1).stamped(Stamp(v=99, source="raw", boot="r", seq=1, mono_ns=1, wall_ns=1))
    with capture_logs() as logs:
        for _ in range(3):
            _through(raw, subscriber, [b"frame/cam0", b"\xc1\xc1"])
            _through(raw, subscriber, [b"frame/cam0", encode(wrong_version)])
            _through(raw, subscriber, [b"frame/cam0", stamped(seen(1))])
            _through(raw, subscriber, [b"frame/cam0"])
            _through(raw, subscriber, [b"frame/cam0/more", stamped(frame(1))])
    assert subscriber.bad_kinds == {"message:frame": 9, "framing": 3, "topic": 3}
    assert subscriber.bad == 15
    assert sorted(entry["kind"] for entry in logs if entry["event"] == "bus.garbage") == [
        "framing",
        "message:frame",
        "topic",
    ]


def test_garbage_does_not_hide_the_newest_valid_frame(bus: Bus, proxy: Proxy, raw: zmq.Socket[bytes]) -> None:
    subscriber = bus.subscriber(FRAME, SERVICE)
    _through(raw, subscriber, [])
    for data in (stamped(frame(1)), stamped(frame(2), seq=2), b"garbage"):
        raw.send_multipart([b"frame/cam0", data])
    raw.send_multipart([b"detections/x", b""])
    wait_for(lambda: subscriber.sockets[0].poll(0), 5, "arrival")
    got: list[int] = []

    def both_known() -> bool:
        got.extend(number_of(received.message) for received in subscriber.receive())
        return subscriber.bad == 1 and bool(got)

    wait_for(both_known, 5, "the frame and the garbage")
    assert got[-1] == 2


def test_an_oversized_message_costs_only_its_sender(bus: Bus, proxy: Proxy, raw: zmq.Socket[bytes]) -> None:
    publisher, subscriber = bus.publisher(), bus.subscriber(FRAME, DETECTIONS, SERVICE)
    bus.connect(publisher, subscriber)
    _through(raw, subscriber, [b"frame/cam0", b"x" * (2 * MAX_BYTES)])
    publisher.publish(DETECTIONS, ("cam0", "markers"), seen(5))
    got: list[Message] = []

    def detections_came() -> bool:
        got.extend(received.message for received in subscriber.receive() if received.topic is not SERVICE)
        return bool(got)

    wait_for(detections_came, 10, "the other publisher's message")
    assert [number_of(message) for message in got] == [5]
    assert subscriber.bad == 0
