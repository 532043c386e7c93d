"""The command socket's table is strict: each wrong request is refused in words, and a right one is understood."""

from __future__ import annotations

from typing import Any

import msgpack
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from common.commands import COMMANDS, GENERAL_ERRORS, Command, RecordCommand, StartCommand
from common.errors import RefusedError
from services.control.describe import help_answer
from services.control.parsing import MAX_REQUEST_BYTES, parse

FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def asked(**fields: Any) -> Command:
    return parse(msgpack.packb(fields))


def refused(data: bytes) -> RefusedError:
    with pytest.raises(RefusedError) as caught:
        parse(data)
    assert caught.value.code in GENERAL_ERRORS
    assert caught.value.message
    return caught.value


def outcome_of(data: bytes) -> Command | RefusedError:
    try:
        return parse(data)
    except RefusedError as error:
        return error


def refused_fields(**fields: Any) -> RefusedError:
    return refused(msgpack.packb(fields))


def test_each_command_with_its_needed_fields_is_understood() -> None:
    needed = {"camera": "cam0", "recording": "rec-1", "name": "monday", "samples": ["a"]}
    for row in COMMANDS.values():
        required = [name for name, field in row.model.model_fields.items() if field.is_required()]
        command = asked(command=row.name, **{name: needed[name] for name in required})
        assert type(command) is row.model


def test_defaults_are_those_of_the_design() -> None:
    command = asked(command="record", camera="cam0")
    assert command == RecordCommand(camera="cam0", count=1, interval_s=0, timeout_s=5, frame=None, background=False)


def test_a_whole_number_is_fine_where_a_number_is_wanted() -> None:
    command = asked(command="start", camera="all", every_s=2, until_count=7, mode="auto")
    assert command == StartCommand(camera="all", every_s=2.0, until_count=7, mode="auto")


@pytest.mark.parametrize(
    ("fields", "code", "words"),
    [
        ({"command": "recrod"}, "unknown_command", "did you mean 'record'?"),
        ({"command": "zzz"}, "unknown_command", "there are status, record"),
        ({"command": 5}, "wrong_type", "'command' must be a text"),
        ({"camera": "cam0"}, "missing_field", "'command' is missing"),
        ({"command": "record"}, "missing_field", "'record' needs the field 'camera'"),
        ({"command": "ledger"}, "missing_field", "'ledger' needs the field 'recording'"),
        ({"command": "record", "camera": "cam0", "cuont": 2}, "unknown_field", "did you mean 'count'?"),
        ({"command": "status", "verbose": True}, "unknown_field", "'status' has no field 'verbose'; it has no fields"),
        ({"command": "record", "camera": 7}, "wrong_type", "'camera' must be a name"),
        ({"command": "record", "camera": "cam0", "count": "3"}, "wrong_type", "a whole number 1..1000"),
        ({"command": "record", "camera": "cam0", "count": True}, "wrong_type", "not True"),
        ({"command": "record", "camera": "cam0", "count": 1.5}, "wrong_type", "not 1.5"),
        ({"command": "record", "camera": "cam0", "background": 1}, "wrong_type", "true or false"),
        ({"command": "record", "camera": "cam0", "count": 0}, "out_of_bounds", "a whole number 1..1000"),
        ({"command": "record", "camera": "cam0", "count": 2**63}, "out_of_bounds", "1..1000"),
        ({"command": "record", "camera": "cam0", "timeout_s": 0}, "out_of_bounds", "above 0..3600"),
        ({"command": "record", "camera": "cam0", "timeout_s": float("nan")}, "out_of_bounds", "not nan"),
        ({"command": "record", "camera": "cam0", "interval_s": float("inf")}, "out_of_bounds", "not inf"),
        ({"command": "record", "camera": "../etc"}, "out_of_bounds", "a name"),
        ({"command": "session", "name": "../elsewhere"}, "out_of_bounds", "a name"),
        ({"command": "session", "name": "/etc"}, "out_of_bounds", "a name"),
        ({"command": "session", "name": ".."}, "out_of_bounds", "a name"),
        ({"command": "record", "camera": "cam0\n"}, "out_of_bounds", "a name"),
        ({"command": "record", "camera": "cam0", "count": 10, "interval_s": 1}, "out_of_bounds", "'timeout_s' above 9"),
        ({"command": "record", "camera": "all", "frame": 3}, "out_of_bounds", "name that camera"),
        ({"command": "record", "camera": "cam0", "frame": 3, "count": 2}, "out_of_bounds", "'count' at 1"),
        ({"command": "start", "camera": "cam0", "mode": "some"}, "out_of_bounds", "'all' or 'auto'"),
        ({"command": "start", "camera": "cam0", "until_count": 0}, "out_of_bounds", "1..10000000"),
        ({"command": "session", "name": "a/b"}, "out_of_bounds", "a name"),
        ({"command": "stop", "recording": ["rec-1"]}, "wrong_type", "'recording' must be a name"),
    ],
)
def test_wrong_requests_are_refused_in_words(fields: dict[str, Any], code: str, words: str) -> None:
    error = refused_fields(**fields)
    assert (error.code, words in error.message) == (code, True), error.message


def test_all_mistakes_are_named_at_once() -> None:
    message = refused_fields(command="record", camera=5, count="x", cuont=1).message
    for part in ("'camera'", "'count'", "'cuont'"):
        assert part in message


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xc1",
        b"\x81",
        b"status",
        msgpack.packb([1, 2]),
        msgpack.packb(None),
        msgpack.packb({1: 2}),
        msgpack.packb({b"command": b"status"}),
        msgpack.packb({"command": "status"})[:-1],
        msgpack.packb({"command": "status"}) + b"x",
        b'{"command": "status"}',
        b"\x91" * 2000,
        msgpack.packb({"command": "status", "x": "y" * MAX_REQUEST_BYTES}),
        msgpack.packb({"command": "status", "when": msgpack.Timestamp(1, 2)}),
    ],
)
def test_garbage_is_refused(data: bytes) -> None:
    refused(data)


@FUZZ
@given(st.binary(max_size=200))
def test_random_bytes_are_refused_or_understood_but_never_a_bug(data: bytes) -> None:
    outcome = outcome_of(data)
    assert isinstance(outcome, Command) or outcome.code in GENERAL_ERRORS


_VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=30)
    | st.binary(max_size=30),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
_FIELDS = sorted({name for row in COMMANDS.values() for name in row.model.model_fields})


@FUZZ
@given(
    st.sampled_from(sorted(COMMANDS)) | st.text(max_size=12),
    st.dictionaries(st.sampled_from(_FIELDS) | st.text(max_size=12), _VALUES, max_size=4),
)
def test_random_fields_are_refused_or_valid(name: str, fields: dict[str, Any]) -> None:
    try:
        data = msgpack.packb({**fields, "command": name})
    except UnicodeEncodeError:
        return  # a lone surrogate never gets onto the wire
    command = outcome_of(data)
    if isinstance(command, RefusedError):
        assert command.code in GENERAL_ERRORS
        return
    given_fields = {key: value for key, value in fields.items() if key != "command"}
    assert set(given_fields) <= set(type(command).model_fields)
    for key, value in given_fields.items():
        assert getattr(command, key) == value


def test_help_describes_every_command_and_field() -> None:
    told = help_answer()["commands"]
    assert set(told) == set(COMMANDS)
    for row in COMMANDS.values():
        assert {name for name in told[row.name]["fields"] if "." not in name} == set(row.model.model_fields)
        assert all(field["words"] for field in told[row.name]["fields"].values())
    assert told["record"]["fields"]["count"] == {
        "type": "a whole number 1..1000",
        "required": False,
        "default": 1,
        "words": "how many samples, for each camera",
    }
    assert told["record"]["fields"]["frame"]["type"] == "a whole number from 1, or nil"
    assert len(msgpack.packb(help_answer())) < MAX_REQUEST_BYTES
