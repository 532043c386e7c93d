"""The table of commands in words: what `help` answers, what docs/reference/commands.md and refusals say. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from pydantic import BaseModel

from common.commands import COMMANDS, Row


def help_answer() -> dict[str, Any]:
    """What `help` answers: each command with its fields (type, default, words), its answer and its refusals."""
    return {"commands": {row.name: _described(row) for row in COMMANDS.values()}}


def _described(row: Row) -> dict[str, Any]:
    fields = {
        field.name: {
            "type": type_words(field.schema),
            "required": field.required,
            **({} if field.required else {"default": field.default}),
            "words": field.schema.get("description", ""),
        }
        for field in fields_of(row.model)
    }
    return {"words": row.words, "fields": fields, "answer": row.answer, "errors": list(row.errors)}


class FieldSchema(NamedTuple):
    """A field of a request with its JSON Schema; one of a map within it is called ``filter.camera``."""

    name: str
    schema: dict[str, Any]
    required: bool

    @property
    def default(self) -> Any:
        """What it is when it is left out; a map is empty then."""
        return {} if is_map(self.schema) else self.schema.get("default")


def fields_of(model: type[BaseModel]) -> tuple[FieldSchema, ...]:
    """All fields of a command, each map followed by its own."""
    schema = model.model_json_schema()
    return tuple(_fields(schema, schema.get("$defs", {}), ""))


def is_map(part: dict[str, Any]) -> bool:
    """Whether a field is a map with fields of its own."""
    return "properties" in part


def _fields(schema: dict[str, Any], shared: dict[str, Any], prefix: str) -> Iterator[FieldSchema]:
    for name, part in schema.get("properties", {}).items():
        known = shared[part["$ref"].rpartition("/")[2]] if "$ref" in part else part
        yield FieldSchema(prefix + name, known, name in schema.get("required", ()))
        if is_map(known):
            yield from _fields(known, shared, f"{prefix}{name}.")


def type_words(part: dict[str, Any]) -> str:
    """A field's type and bounds in words, from its JSON Schema: ``a whole number 1..1000``."""
    if "anyOf" in part:
        kinds = [type_words(each) for each in part["anyOf"] if each.get("type") != "null"]
        return " or ".join(kinds) + ", or nil"
    if is_map(part):
        return "a map"
    if part.get("type") == "array":
        return f"a list of {part['minItems']}..{part['maxItems']} names"
    if "pattern" in part:
        return "a name (letters, digits, '.', '_', '-')"
    if "enum" in part:
        return " or ".join(f"'{value}'" for value in part["enum"])
    word = {"string": "a text", "integer": "a whole number", "number": "a number", "boolean": "true or false"}[
        part["type"]
    ]
    low = part.get("minimum", part.get("exclusiveMinimum"))
    high = part.get("maximum")
    if low is None and high is None:
        return word
    above = "above " if "exclusiveMinimum" in part else ""
    return f"{word} {above}{low:.15g}..{high:.15g}" if high is not None else f"{word} from {above}{low:.15g}"
