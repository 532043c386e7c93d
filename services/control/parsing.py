"""From bytes to a command. Pure.

A request is a MessagePack map with a field `command`. Nothing is guessed: an unknown command or field, a missing
field, a wrong type or a value out of bounds is refused in one sentence that says what would be right.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from typing import Any

from pydantic import ValidationError

from common.commands import COMMANDS, Command, Row
from common.errors import CodecError, RefusedError
from common.messages import unpack
from services.control.describe import fields_of, type_words

MAX_REQUEST_BYTES = 64 * 1024
_SHOWN_CHARACTERS = 40


def parse(data: bytes) -> Command:
    """The request in ``data``; raises RefusedError with a code of `GENERAL_ERRORS` and one sentence."""
    try:
        plain = unpack(data, MAX_REQUEST_BYTES)
    except CodecError as error:
        raise RefusedError(f"that is no command: {error.message}", code="not_a_command") from error
    if not isinstance(plain, dict) or not all(isinstance(key, str) for key in plain):
        raise RefusedError('a command is a MessagePack map such as {"command": "status"}', code="not_a_command")
    fields: dict[str, Any] = dict(plain)
    if "command" not in fields:
        raise RefusedError(f"the field 'command' is missing; it is one of {_listed(COMMANDS)}", code="missing_field")
    name = fields.pop("command")
    if not isinstance(name, str):
        raise RefusedError(f"'command' must be a text, not {_shown(name)}", code="wrong_type")
    row = COMMANDS.get(name)
    if row is None:
        raise RefusedError(
            f"there is no command {_shown(name)}{_suggestion(name, COMMANDS)}; there are {_listed(COMMANDS)}",
            code="unknown_command",
        )
    try:
        return row.model.model_validate(fields)
    except ValidationError as error:
        raise _refusal(row, error) from None


_WRONG_VALUE = {"greater_than", "greater_than_equal", "less_than", "less_than_equal", "literal_error", "value_error"}
_WRONG_SIZE = {"too_short", "too_long", "string_too_short", "string_too_long"}
_OUT_OF_BOUNDS = _WRONG_VALUE | _WRONG_SIZE | {"string_pattern_mismatch", "finite_number"}


def _refusal(row: Row, error: ValidationError) -> RefusedError:
    """All mistakes of a request in one refusal; the code is the first one's."""
    code, sentences = "", []
    for mistake in error.errors(include_url=False, include_context=False):
        field = ".".join(part for part in mistake["loc"] if isinstance(part, str))  # a number: its place in a list
        if mistake["type"] == "extra_forbidden":
            its_code = "unknown_field"
            parent, _, name = field.rpartition(".")
            known = _known_in(row, parent)
            has = f"it has {_listed(known)}" if known else "it has no fields"
            where = f"'{parent}' of '{row.name}'" if parent else f"'{row.name}'"
            sentences.append(f"{where} has no field {_shown(name)}{_suggestion(name, known)}; {has}")
        elif mistake["type"] == "missing":
            its_code = "missing_field"
            sentences.append(f"'{row.name}' needs the field '{field}'")
        elif mistake["type"] == "value_error":
            its_code = "out_of_bounds"
            sentences.append(mistake["msg"].removeprefix("Value error, "))
        else:
            its_code = "out_of_bounds" if mistake["type"] in _OUT_OF_BOUNDS else "wrong_type"
            sentences.append(f"'{field}' must be {_wanted(row, field)}, not {_shown(mistake['input'])}")
        code = code or its_code
    return RefusedError("; ".join(dict.fromkeys(sentences)), code=code)


def _known_in(row: Row, parent: str) -> list[str]:
    """The fields of a command (parent ''), or of a map within it."""
    parts = (field.name.rpartition(".") for field in fields_of(row.model))
    return [name for place, _, name in parts if place == parent]


def _wanted(row: Row, field: str) -> str:
    part = next(known.schema for known in fields_of(row.model) if known.name == field)
    words = part.get("description", "")
    return type_words(part) + (f" ({words})" if words else "")


def _suggestion(word: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(word[:_SHOWN_CHARACTERS], list(known), n=1, cutoff=0.6)
    return f"; did you mean '{near[0]}'?" if near else ""


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names)


def _shown(value: object) -> str:
    """A value as an error quotes it: short, on one line."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    text = ascii(value)
    return text if len(text) <= _SHOWN_CHARACTERS else text[: _SHOWN_CHARACTERS - 3] + "..."
