"""OpenCV's FileStorage files (YAML 1.0, XML, JSON) as plain values.

Read here and not by ``cv2.FileStorage``: OpenCV's readers descend into whatever a file nests until the stack is
gone, and the process with it. What is read here is what OpenCV's own writer makes and what people write by hand in
its manner; the format is described in OpenCV's tutorial "File Input and Output using XML / YAML / JSON files".
"""

from __future__ import annotations

import re
from typing import Any
from xml.parsers import expat

import yaml
from yaml.events import (
    AliasEvent,
    CollectionEndEvent,
    CollectionStartEvent,
    DocumentEndEvent,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
)

from common.bounded import parse_json

MAX_DEPTH = 24
MAX_VALUES = 100_000

Value = Any
"""A dict by name, a list, a text, an int, a float or None."""

_YAML_HEAD = re.compile(r"\A\s*%YAML[: ]\s*1\.0[^\n]*\n")
_XML_HEADS = ("<?xml", "<opencv_storage")
_INT = re.compile(r"[-+]?[0-9]{1,18}")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]{1,4})?")
_SPECIAL = {".inf": float("inf"), "-.inf": float("-inf"), ".nan": float("nan")}
_ROOT = "opencv_storage"


def is_file_storage(text: str) -> bool:
    """Whether a text is meant as one (JSON apart, which anything may be)."""
    begin = text.lstrip()[:200]
    return begin.startswith((*_XML_HEADS, "%YAML:1.0", "%YAML 1.0")) or "!!opencv-matrix" in text


def parse_file_storage(text: str) -> dict[str, Value]:
    """The names and values at the top of a file; raises ValueError that says what is wrong with it.

    A matrix stays the map that the file has: ``rows``, ``cols``, ``dt`` and its ``data`` in a flat list.
    """
    begin = text.lstrip()[:200]
    if begin.startswith("{"):
        plain = parse_json(text)
        _check_depth(plain)
        return plain if isinstance(plain, dict) else {}
    return _XmlReader().read(text) if begin.startswith(_XML_HEADS) else _read_yaml(text)


# --- what all three share

_Pairs = list[tuple[str, Value]]


class _Tree:
    """Named values as they open and close, within limits."""

    def __init__(self) -> None:
        self._open: list[tuple[str, _Pairs]] = []
        self._values = 0

    @property
    def depth(self) -> int:
        return len(self._open)

    def open(self, name: str) -> None:
        if self.depth >= MAX_DEPTH:
            raise ValueError(f"it is nested deeper than {MAX_DEPTH} levels")
        self._open.append((name, []))

    def put(self, name: str, value: Value) -> None:
        self._values += 1
        if self._values > MAX_VALUES:
            raise ValueError(f"it has more than {MAX_VALUES} values")
        self._open[-1][1].append((name, value))

    def close(self) -> tuple[str, _Pairs]:
        return self._open.pop()


def _map(pairs: _Pairs) -> dict[str, Value]:
    found: dict[str, Value] = {}
    for name, value in pairs:
        if name in found:
            raise ValueError(f"'{name[:40]}' is given twice")
        found[name] = value
    return found


def _check_depth(plain: Value) -> None:
    level, depth = [plain], 0
    while level := [inner for value in level for inner in _inside(value)]:
        depth += 1
        if depth > MAX_DEPTH:
            raise ValueError(f"it is nested too deeply, more than {MAX_DEPTH} levels")


def _inside(value: Value) -> list[Value]:
    inner = list(value.values()) if isinstance(value, dict) else value if isinstance(value, list) else []
    return [one for one in inner if isinstance(one, dict | list)]


def _scalar(text: str) -> Value:
    """What an unquoted word means; OpenCV knows no booleans."""
    if _INT.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    return _SPECIAL.get(text.lower(), text or None)


# --- YAML

_ITEM = ""
"""Stands for the name of what is an item of a list."""


def _read_yaml(text: str) -> dict[str, Value]:
    body = _YAML_HEAD.sub("\n", text, count=1)
    root: Value = None
    try:
        root = _YamlReader().read(body)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f" on line {mark.line + 1}"
        raise ValueError(f"it is no valid YAML{where}: {getattr(error, 'problem', None) or 'damaged'}") from None
    return root if isinstance(root, dict) else {}


class _YamlReader:
    """From YAML's events, one after the other: nothing here calls itself."""

    def __init__(self) -> None:
        self._tree = _Tree()
        self._names: list[str | None] = []
        """Of each open value: the name of the next one in it, _ITEM in a list, None while the name is awaited."""

    def read(self, text: str) -> Value:
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            if isinstance(event, AliasEvent):
                raise ValueError("aliases (*name) are not supported")  # noqa: TRY004 - what the text has, not a type of ours
            if isinstance(event, CollectionStartEvent):
                self._tree.open(self._name() if self._names else _ITEM)
                self._names.append(None if isinstance(event, MappingStartEvent) else _ITEM)
            elif isinstance(event, CollectionEndEvent):
                self._names.pop()
                name, pairs = self._tree.close()
                value = _map(pairs) if isinstance(event, MappingEndEvent) else [one for _, one in pairs]
                if not self._tree.depth:
                    return value
                self._tree.put(name, value)
            elif isinstance(event, ScalarEvent):
                self._put(event)
            elif isinstance(event, DocumentEndEvent):
                break
        return None

    def _name(self) -> str:
        """The name that came before the value which begins now."""
        name = self._names[-1]
        if name is None:
            raise ValueError("a name must be plain text")
        if name != _ITEM:
            self._names[-1] = None
        return name

    def _put(self, event: ScalarEvent) -> None:
        if not self._names:
            return  # a text without any name: no FileStorage
        if self._names[-1] is None:
            if event.value == "":
                raise ValueError("a name is empty")
            self._names[-1] = event.value
            return
        self._tree.put(self._name(), _scalar(event.value) if event.style is None else event.value)


# --- XML

_XML_ITEM = "_"


class _XmlReader:
    """Elements by name; ``<_>`` is an item of a list, a text of several words is a list of them."""

    def __init__(self) -> None:
        self._tree = _Tree()
        self._text: list[str] = []
        self._root: Value = None
        self._parser = expat.ParserCreate("utf-8")
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._text.append
        self._parser.StartDoctypeDeclHandler = self._refuse_doctype

    def read(self, text: str) -> dict[str, Value]:
        try:
            self._parser.Parse(text.encode("utf-8", "replace"), True)
        except expat.ExpatError as error:
            raise ValueError(f"it is no valid XML on line {error.lineno}: {expat.ErrorString(error.code)}") from None
        return self._root if isinstance(self._root, dict) else {}

    @staticmethod
    def _refuse_doctype(*_: Any) -> None:
        raise ValueError("it has a document type declaration, which OpenCV never writes")

    def _start(self, name: str, _attributes: dict[str, str]) -> None:
        if not self._tree.depth and name != _ROOT:
            raise ValueError(f"its root is <{name[:40]}>, that of a FileStorage file is <{_ROOT}>")
        self._text.clear()
        self._tree.open(name)

    def _end(self, _name: str) -> None:
        name, pairs = self._tree.close()
        words = "".join(self._text)
        self._text.clear()
        value = _of_element(pairs, words)
        if self._tree.depth:
            self._tree.put(name, value)
        else:
            self._root = value


def _of_element(pairs: _Pairs, text: str) -> Value:
    if pairs:
        names = {name for name, _ in pairs}
        return [value for _, value in pairs] if names == {_XML_ITEM} else _map(pairs)
    text = text.strip()
    if len(text) > 1 and text[0] == text[-1] == '"' and '"' not in text[1:-1]:
        return text[1:-1]
    words = [_scalar(word) for word in text.split()]
    if len(words) > 1 and all(isinstance(word, int | float) for word in words):
        if len(words) > MAX_VALUES:
            raise ValueError(f"it has more than {MAX_VALUES} values")
        return words
    return words[0] if len(words) == 1 else text or None
