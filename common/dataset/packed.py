"""Samples as they are listed, packed: some 400 bytes each, where a ``SampleItem`` takes 5,000.

A recording adds thirty a second for hours, and the list of them stays in memory.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import msgpack

from common.messages import SampleItem, SampleObject

_FIELDS = tuple(SampleItem.model_fields)
_OBJECT_FIELDS = tuple(SampleObject.model_fields)
_NAME = "*"
"""Stands for the sample's name in its files' paths; no name has it in it."""


def pack(item: SampleItem) -> bytes:
    """All of it but its name."""
    plain = dict(item)
    plain["name"] = None
    plain["objects"] = [[getattr(found, field) for field in _OBJECT_FIELDS] for found in item.objects]
    plain["files"] = {kind: path.replace(item.name, _NAME) for kind, path in item.files.items()}
    return cast("bytes", msgpack.packb([plain[field] for field in _FIELDS]))


def unpack(name: str, packed: bytes) -> SampleItem:
    """What was packed."""
    return cast("SampleItem", _made(name, packed, SampleItem.model_construct, SampleObject.model_construct))


def peek(name: str, packed: bytes) -> SampleItem:
    """The same with a ``SampleItem``'s attributes but none of its methods: quick, for looking through many."""
    return cast("SampleItem", _made(name, packed, SimpleNamespace, SimpleNamespace))


def _made(name: str, packed: bytes, item: Callable[..., object], found: Callable[..., object]) -> object:
    plain: dict[str, Any] = dict(zip(_FIELDS, msgpack.unpackb(packed, use_list=False), strict=True))
    plain["name"] = name
    plain["objects"] = tuple(found(**dict(zip(_OBJECT_FIELDS, one, strict=True))) for one in plain["objects"])
    plain["files"] = {kind: path.replace(_NAME, name) for kind, path in plain["files"].items()}
    return item(**plain)
