"""YAML as a tree in which every value knows its line.

Scalars are read by the YAML 1.2 rules (``yes`` and ``010`` mean what they look like, ``1e-3`` is a number).
The reader is meant for files written by hand: it bounds size, nesting and the number of values, so that no
file, however made, can eat the memory.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.events import CollectionEndEvent, CollectionStartEvent
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from yaml.parser import Parser
from yaml.reader import Reader
from yaml.resolver import BaseResolver
from yaml.scanner import Scanner

from common.bounded import TooLargeError, read_bytes
from common.config.problems import FieldPath, Problems

MAX_BYTES = 256 * 1024
MAX_DEPTH = 24
MAX_VALUES = 20_000

Scalar = str | int | float | bool | None


@dataclass(slots=True)
class Tree:
    """A value with its place. ``line`` is that of its key, or of its list item; ``path`` is where the file has it."""

    path: FieldPath
    line: int
    value: Scalar | dict[str, Tree] | list[Tree]

    def plain(self) -> Any:
        """The value as dicts, lists and scalars."""
        if isinstance(self.value, dict):
            return {key: child.plain() for key, child in self.value.items()}
        if isinstance(self.value, list):
            return [child.plain() for child in self.value]
        return self.value

    def child(self, part: str | int) -> Tree | None:
        """What lies directly below, None if there is no such key or item."""
        if isinstance(self.value, dict):
            return self.value.get(str(part))
        if isinstance(self.value, list) and isinstance(part, int) and 0 <= part < len(self.value):
            return self.value[part]
        return None

    def nearest(self, path: FieldPath) -> Tree:
        """What lies at ``path`` counted from here, or the last that exists on the way there."""
        here = self
        for part in path:
            below = here.child(part)
            if below is None:
                return here
            here = below
        return here

    def remove(self, path: FieldPath) -> bool:
        """Take away what lies at ``path``; whether there was something."""
        parent = self.nearest(path[:-1])
        if not path or parent.child(path[-1]) is None:
            return False
        if isinstance(parent.value, dict):
            del parent.value[str(path[-1])]
        elif isinstance(parent.value, list):
            del parent.value[int(path[-1])]
        return True


def read_text(path: Path, problems: Problems, what: str = "rig file") -> str | None:
    """The file's text, or None with the reason noted."""
    try:
        if path.is_dir():
            problems.add(0, (), f"is a directory; name the {what} in it")
            return None
        data = read_bytes(path, MAX_BYTES)
    except FileNotFoundError:
        problems.add(0, (), f"there is no such file; name an existing {what}")
        return None
    except TooLargeError:
        problems.add(0, (), f"is larger than {MAX_BYTES // 1024} KiB; that is no {what}")
        return None
    except (OSError, ValueError) as error:
        problems.add(0, (), f"can't be read: {getattr(error, 'strerror', None) or error}")
        return None
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        problems.add(line, (), f"is not UTF-8 text (byte 0x{data[error.start]:02x}); save the file as UTF-8")
        return None


def read_tree(path: Path, problems: Problems, what: str = "rig file") -> Tree | None:
    """The file as a tree whose root is a map, or None with the reason noted.

    Mistakes that leave the rest readable (a key given twice, a number that isn't finite) are noted and the
    tree comes without those values.
    """
    text = read_text(path, problems, what)
    return None if text is None else parse_tree(text, problems, what)


def parse_tree(text: str, problems: Problems, what: str = "rig file") -> Tree | None:
    """Like ``read_tree``, from text."""
    try:
        _check_nesting(text)
        document = _Loader(text).get_single_node()
    except _TooDeepError as error:
        problems.add(error.line, (), f"is nested deeper than {MAX_DEPTH} levels; that is no {what}")
        return None
    except yaml.YAMLError as error:
        problems.add(*_syntax(error, text))
        return None
    if document is None or (isinstance(document, ScalarNode) and document.value == ""):
        problems.add(0, (), f"is empty; a {what} is a map of keys")
        return None
    if not isinstance(document, MappingNode):
        problems.add(_line(document), (), f"must be a map (key: value) at the top, not {_kind(document)}")
        return None
    return _Builder(problems).build(document)


class _Loader(Reader, Scanner, Parser, Composer, BaseResolver):
    """Composes nodes only; what a scalar means is decided in ``_Builder``."""

    def __init__(self, stream: str) -> None:
        Reader.__init__(self, stream)
        Scanner.__init__(self)
        Parser.__init__(self)
        Composer.__init__(self)
        BaseResolver.__init__(self)


def _check_nesting(text: str) -> None:
    """Raise a YAMLError where the nesting is deeper than a hand-written file's; the composer would recurse."""
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, CollectionStartEvent):
            depth += 1
        elif isinstance(event, CollectionEndEvent):
            depth -= 1
        if depth > MAX_DEPTH:
            mark = event.start_mark
            raise _TooDeepError(0 if mark is None else mark.line + 1)


class _TooDeepError(Exception):
    """The text is nested deeper than MAX_DEPTH, from this line on."""

    def __init__(self, line: int) -> None:
        super().__init__(line)
        self.line = line


_YAML_TAG = "tag:yaml.org,2002:"
_PLAIN_TAGS = {_YAML_TAG + kind for kind in ("str", "map", "seq")}
_NULL = re.compile(r"^(?:null|Null|NULL|~|)$")
_BOOL = re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$")
_INT = re.compile(r"^[-+]?[0-9]{1,18}$")
_HEX = re.compile(r"^0x[0-9a-fA-F]{1,15}$")
_FLOAT = re.compile(r"^[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$")
_NOT_FINITE = re.compile(r"^(?:[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$")
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f\ud800-\udfff]")


class _Builder:
    """Turns composed nodes into a ``Tree``; aliases are written out, within limits."""

    def __init__(self, problems: Problems) -> None:
        self._problems = problems
        self._values = 0
        self._full = False

    def build(self, document: MappingNode) -> Tree | None:
        tree = self._tree(document, (), _line(document))
        return None if self._full else tree

    def _tree(self, node: Node, path: FieldPath, line: int) -> Tree | None:
        self._values += 1
        if self._full or self._values > MAX_VALUES or len(path) > MAX_DEPTH:
            if not self._full:
                self._problems.add(line, (), f"aliases (*name) unfold to more than {MAX_VALUES} values or endlessly")
            self._full = True
            return None
        if node.tag not in _PLAIN_TAGS:
            tag = node.tag.replace(_YAML_TAG, "!!")
            self._problems.add(line, path, f"the YAML tag {tag} is not supported; write a plain value")
            return None
        if isinstance(node, MappingNode):
            return Tree(path, line, self._map(node, path))
        if isinstance(node, SequenceNode):
            items = [self._tree(item, (*path, i), _line(item)) for i, item in enumerate(node.value)]
            return Tree(path, line, [item for item in items if item is not None])
        return self._scalar(node, path, line)

    def _map(self, node: MappingNode, path: FieldPath) -> dict[str, Tree]:
        found: dict[str, Tree] = {}
        lines: dict[str, int] = {}
        for key, value in node.value:
            if not isinstance(key, ScalarNode):
                self._problems.add(_line(key), path, f"a key must be plain text, not {_kind(key)}")
                continue
            if key.value == "<<":
                self._problems.add(_line(key), path, "merge keys (<<) are not supported; write the keys out")
                continue
            if key.value in lines:
                reason = f"the key '{key.value}' is given twice (first on line {lines[key.value]}); keep one"
                self._problems.add(_line(key), (*path, key.value), reason)
                continue
            lines[key.value] = _line(key)
            child = self._tree(value, (*path, key.value), _line(key))
            if child is not None:
                found[key.value] = child
        return found

    def _scalar(self, node: Node, path: FieldPath, line: int) -> Tree | None:
        text: str = node.value
        if CONTROL.search(text):
            self._problems.add(line, path, f"{text!r} contains a control character; remove it")
            return None
        if not isinstance(node, ScalarNode) or node.style is not None:
            return Tree(path, line, text)
        if _NOT_FINITE.match(text):
            self._problems.add(line, path, f"{text} is not allowed; it must be a finite number")
            return None
        value = _plain_scalar(text)
        if isinstance(value, float) and not math.isfinite(value):
            self._problems.add(line, path, f"{text} is too large; it must be a finite number")
            return None
        return Tree(path, line, value)


def _plain_scalar(text: str) -> Scalar:
    """What an unquoted scalar means."""
    if _NULL.match(text):
        return None
    if _BOOL.match(text):
        return text.lower() == "true"
    if _INT.match(text):
        return int(text)
    if _HEX.match(text):
        return int(text, 16)
    return float(text) if _FLOAT.match(text) else text


def _line(node: Node) -> int:
    return int(node.start_mark.line) + 1


def _kind(node: Node) -> str:
    return (
        "a list" if isinstance(node, SequenceNode) else "a map" if isinstance(node, MappingNode) else "a single value"
    )


def _syntax(error: yaml.YAMLError, text: str) -> tuple[int, FieldPath, str]:
    """Line and plain words for what the YAML parser stumbled over."""
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    if mark is None:
        position = getattr(error, "position", 0)
        line = text.count("\n", 0, position) + 1
        return line, (), f"contains a character that YAML doesn't allow: {getattr(error, 'character', '?')!r}"
    line = mark.line + 1
    source = text.splitlines()[mark.line] if mark.line < len(text.splitlines()) else ""
    if "\t" in source[: len(source) - len(source.lstrip())] or (
        mark.column < len(source) and source[mark.column] == "\t"
    ):
        return line, (), "is indented with a tab; YAML allows spaces only"
    said = getattr(error, "problem", None) or "is not understood"
    context = getattr(error, "context", None)
    return line, (), f"is no valid YAML at column {mark.column + 1}: {said}" + (f" ({context})" if context else "")
