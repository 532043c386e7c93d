"""The codec is strict, bounded and says what is wrong; the table of topics is consistent."""

from __future__ import annotations

import contextlib
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from common import messages
from common.errors import CodecError
from common.labels import LABEL_SCHEMA
from common.ledgers import CameraLedger, Ledger, RecordingSpec
from common.messages import (
    MAX_BYTES,
    SCHEMA_VERSION,
    Answer,
    FrameAnnounced,
    FrameRef,
    Message,
    Order,
    ServiceState,
    Shares,
    Stamp,
    decode,
    encode,
    encode_stamped,
    unpack,
)
from common.topics import TOPICS, topic_of

STAMP = Stamp(source="s", boot="b", seq=1, mono_ns=2, wall_ns=3)
REF = FrameRef(camera="c", boot="b", ring="r", frame=1, count=1, captured_mono_ns=1, captured_wall_ns=1)
FRAME = FrameAnnounced(ref=REF).stamped(STAMP)
LEDGER = Ledger(
    spec=RecordingSpec(recording="r", mode="all", cameras=("c",), started_at="now"),
    phase="running",
    cameras={"c": CameraLedger(captured=2, recorded=1, refused={"no_object": 1})},
)


@pytest.mark.parametrize(
    "message",
    [
        FRAME,
        ServiceState(service="s", boot="b", pid=1, phase="running", rates={"fps": 1.5}, dropped={"x": 1}),
        Shares(detect={"cam0": 1}, label={}),
        Answer(key="k", samples=("a", "b"), ledgers=(LEDGER,)),
    ],
)
def test_what_is_packed_comes_back_equal(message: BaseModel) -> None:
    assert decode(type(message), encode(message)) == message


def changed(**changes: Any) -> bytes:
    plain = FRAME.model_dump(by_alias=True)
    for path, value in changes.items():
        *parents, last = path.split("__")
        target = plain
        for parent in parents:
            target = target[parent]
        target[last] = value
    packed: bytes = msgpack.packb(plain)
    return packed


@pytest.mark.parametrize(
    ("data", "names"),
    [
        (changed(more=1), "more"),
        (changed(ref__more=1), r"ref\.more"),
        (changed(ref__frame="1"), r"ref\.frame"),
        (changed(ref__frame=1.5), r"ref\.frame"),
        (changed(ref__frame=True), r"ref\.frame"),
        (changed(ref__camera=None), r"ref\.camera"),
        (changed(ref__preview=0), r"ref\.preview"),
        (changed(ref=[]), "ref"),
        (changed(stamp__seq="x"), r"stamp\.seq"),
        (changed(stamp__v=SCHEMA_VERSION + 1), "schema version 2, this tagmill reads 1"),
        (changed(stamp__v="1"), "schema version"),
        (msgpack.packb({}), r"ref: Field required"),
        (msgpack.packb([1]), "the message"),
        (msgpack.packb(None), "the message"),
        (b"", "not MessagePack"),
        (b"\xc1", "not MessagePack"),
        (encode(FRAME)[:-1], "not MessagePack"),
        (encode(FRAME) + b"\x00", "not MessagePack"),
        (msgpack.packb({1: 2}), "not MessagePack"),
        (msgpack.packb({"ref": msgpack.ExtType(5, b"x")}), "ref"),
        (b"\x81" * 2000, "not MessagePack"),
        (b"\xdd\xff\xff\xff\xff", "not MessagePack"),
        (b"x" * (MAX_BYTES + 1), "larger than"),
    ],
)
def test_anything_else_is_refused_by_name(data: bytes, names: str) -> None:
    with pytest.raises(CodecError, match=names):
        decode(FrameAnnounced, data)


@given(st.binary(max_size=400))
def test_random_bytes_raise_nothing_but_codec_errors(data: bytes) -> None:
    with contextlib.suppress(CodecError):
        decode(FrameAnnounced, data)


@given(st.integers(0, len(encode(FRAME)) - 1), st.integers(0, 255))
def test_a_flipped_byte_is_refused_or_a_valid_message(position: int, byte: int) -> None:
    data = bytearray(encode(FRAME))
    data[position] = byte
    with contextlib.suppress(CodecError):
        assert isinstance(decode(FrameAnnounced, bytes(data)), FrameAnnounced)


def test_a_message_stamped_on_its_way_is_the_same_as_a_stamped_one() -> None:
    assert encode_stamped(FrameAnnounced(ref=REF), "s", "b", 1, 2, 3) == encode(FRAME)


def test_too_large_is_refused_on_both_sides() -> None:
    large = Answer(key="k", text="x" * MAX_BYTES)
    with pytest.raises(CodecError, match="larger than"):
        encode(large)
    with pytest.raises(CodecError, match="larger than 10"):
        unpack(b"x" * 11, 10)


def test_messages_can_not_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        FRAME.ref = REF


def test_every_model_is_frozen_and_refuses_the_unknown() -> None:
    models = [value for name in messages.__all__ if isinstance(value := getattr(messages, name), type)]
    for model in models:
        if issubclass(model, BaseModel):
            assert model.model_config.get("frozen"), model
            assert model.model_config.get("extra") == "forbid", model


def test_each_kind_of_order_is_told_apart_by_its_kind() -> None:
    kinds = [
        value.model_fields["kind"].default
        for name in messages.__all__
        if isinstance(value := getattr(messages, name), type) and issubclass(value, Order) and value is not Order
    ]
    assert len(kinds) == len(set(kinds)) > 5


def test_a_settled_ledger_adds_up() -> None:
    assert LEDGER.cameras["c"].settled
    assert not CameraLedger(captured=1).settled
    assert LABEL_SCHEMA == "tagmill.label/1"


# --- topics -----------------------------------------------------------------------------------------------


def test_topics_have_unique_names_and_messages_of_their_own() -> None:
    assert len({topic.name for topic in TOPICS}) == len(TOPICS)
    assert len({topic.message for topic in TOPICS}) == len(TOPICS)
    assert all(issubclass(topic.message, Message) for topic in TOPICS)
    assert all(topic.purpose and topic.publisher for topic in TOPICS)


def test_every_message_of_the_bus_has_a_topic() -> None:
    published = {topic.message for topic in TOPICS}
    defined = {
        value
        for name in messages.__all__
        if isinstance(value := getattr(messages, name), type) and issubclass(value, Message) and value is not Message
    }
    assert defined == published


def test_a_topics_key_on_the_wire() -> None:
    for topic in TOPICS:
        parts = tuple(f"k{number}" for number in range(len(topic.keys)))
        assert topic_of(topic.key(*parts)) is topic
        if parts:
            assert topic.key().endswith(b"/")
            assert topic.key(*parts).startswith(topic.key())
        with pytest.raises(ValueError, match="key parts"):
            topic.key(*parts, "more")


@pytest.mark.parametrize("wire", [b"", b"unknown", b"fram", b"frames/cam0", b"\xff/x"])
def test_an_unknown_topic_is_none(wire: bytes) -> None:
    assert topic_of(wire) is None
