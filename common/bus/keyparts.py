"""What the parts of a topic after its name may be: names of cameras, sources, recordings, services."""

from __future__ import annotations

import re

from common.topics import Topic

_PART = re.compile(rb"[A-Za-z0-9][A-Za-z0-9_.-]{0,127}\Z")


def has_valid_keys(topic: Topic, wire: bytes) -> bool:
    """Whether the topic ``wire``, as it came or will go, has the right number of well-formed parts."""
    parts = wire.split(b"/")[1:]
    return len(parts) == len(topic.keys) and all(_PART.match(part) for part in parts)
