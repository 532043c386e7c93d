"""`python -m tools.docs` (`make docs`): the reference pages that are made from the code's own tables."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from common.commands import COMMANDS, GENERAL_ERRORS, Row
from common.dataset import SCHEMA_PAGE, label_schema_text
from common.messages import Message
from common.topics import TOPICS, Topic
from common.words import words_for
from services.control.describe import fields_of, type_words

ROOT = Path(__file__).resolve().parents[1]
TOPICS_PAGE = "docs/reference/topics.md"
COMMANDS_PAGE = "docs/reference/commands.md"
_MADE = "<!-- Made by `make docs`; don't edit. -->"


def pages() -> dict[str, str]:
    """Each generated page's path, relative to the project, and its text."""
    return {TOPICS_PAGE: topics_page(), COMMANDS_PAGE: commands_page(), SCHEMA_PAGE: label_schema_text()}


def main() -> int:
    """Write all pages; those that were up to date stay untouched."""
    for name, text in pages().items():
        path = ROOT / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
            print(f"wrote {name}")
    return 0


def topics_page() -> str:
    """The table of topics and the fields of their messages, from `common/topics.py` and `common/messages`."""
    return "\n".join([*_topics_head(), *(line for topic in TOPICS for line in _topic(topic)), ""])


def _topics_head() -> Iterator[str]:
    yield from (
        _MADE,
        "# Topics",
        "",
        "What travels by publish/subscribe through the bus. A message has two parts: the topic (`name/key/...`) and",
        "a MessagePack map. Each message carries a `stamp`: schema version `v`, `source` (service id), `boot` (that",
        "process's life), `seq` (counts per topic and key), `mono_ns`, `wall_ns`. `latest`: a reader that lags gets",
        "the newest of each key; `every`: all, in order. The table is `common/topics.py`.",
        "",
        "| topic | from | rate | delivery | |",
        "|---|---|---|---|---|",
    )
    for topic in TOPICS:
        rate = f"{topic.rate_hz:g} Hz" if topic.rate_hz else "each frame" if topic.keys else "when it happens"
        yield f"| [`{_wire(topic)}`](#{topic.name}) | {topic.publisher} | {rate} | {topic.delivery} | {topic.purpose} |"


def _topic(topic: Topic) -> Iterator[str]:
    yield from ("", f"## {topic.name}", "", f"`{_wire(topic)}`: {_summary(topic.message)}", "")
    yield from ("| field | type | default |", "|---|---|---|")
    for name, field in topic.message.model_fields.items():
        if name == "stamp":
            continue
        default = "" if field.is_required() else f"`{field.default!r}`"
        yield f"| `{name}` | `{_type_name(field.annotation)}` | {default} |"


def _wire(topic: Topic) -> str:
    return "/".join((topic.name, *(f"<{key}>" for key in topic.keys)))


def _summary(message: type[Message]) -> str:
    """A message's docstring in one paragraph."""
    return " ".join((message.__doc__ or "").replace("``", "`").split())


def _type_name(annotation: object) -> str:
    """An annotation as it is written, without module names."""
    if isinstance(annotation, type) and not hasattr(annotation, "__args__"):
        return annotation.__name__
    text = str(annotation).replace("typing.", "").replace("|", "\\|")
    for module in (
        "common.messages.frames.",
        "common.messages.detections.",
        "common.messages.samples.",
        "common.messages.state.",
        "common.labels.",
        "common.evidence.",
    ):
        text = text.replace(module, "")
    return text


def commands_page() -> str:
    """The command socket, from `common/commands.py`."""
    lines = [
        _MADE,
        "# The command socket",
        "",
        "A ZeroMQ ROUTER at `tcp://127.0.0.1:5750` (`network.command` in the rig file). A request is one MessagePack",
        "map of at most 64 KiB with a field `command`; each request gets one answer, a map with `ok`. A refusal is",
        '`{"ok": false, "error": {"code": ..., "message": ...}, ...}`: the code for programs, the message for people.',
        "An unknown command or field, a wrong type, a value out of bounds or garbage is refused and changes nothing;",
        "a request over the limit costs its sender the connection. REQ and DEALER sockets work alike. How to use it in",
        "ten lines: [record over the socket](../how-to/record-over-the-socket.md).",
        "",
        "Off loopback the socket wants CURVE keys: `tagmill keys`, and `network.keys` in the rig file.",
        "",
        f"Any request may be refused with: {_codes(GENERAL_ERRORS)}.",
    ]
    lines += [line for row in COMMANDS.values() for line in _command(row)]
    lines += ["", "## Codes", "", "| code | in words | what to do |", "|---|---|---|"]
    lines += [
        f"| `{code}` | {words_for(code).title} | {words_for(code).what_to_do} |"
        for code in sorted({*GENERAL_ERRORS, *(code for row in COMMANDS.values() for code in row.errors)})
    ]
    return "\n".join([*lines, ""])


def _command(row: Row) -> Iterator[str]:
    yield from ("", f"## {row.name}", "", f"{row.words[:1].upper()}{row.words[1:]}.", "")
    fields = fields_of(row.model)
    if fields:
        yield from ("| field | type | default | |", "|---|---|---|---|")
    for field in fields:
        default = "needed" if field.required else f"`{_shown(field.default)}`"
        words = " ".join(field.schema.get("description", "").split())
        yield f"| `{field.name}` | {type_words(field.schema)} | {default} | {words} |"
    if fields:
        yield ""
    yield f"Answers: {row.answer}."
    if row.errors:
        yield from ("", f"May be refused with: {_codes(row.errors)}.")


def _shown(value: object) -> str:
    """A default as MessagePack calls it."""
    if value is None:
        return "nil"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _codes(codes: tuple[str, ...]) -> str:
    return ", ".join(f"`{code}`" for code in codes)


if __name__ == "__main__":
    sys.exit(main())
