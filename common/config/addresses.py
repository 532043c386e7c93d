"""Addresses of network cameras, which may hold a user name and a password."""

from __future__ import annotations

import re
from typing import Any
from urllib.parse import urlsplit

SCHEMES = ("rtsp", "rtsps", "http", "https", "udp", "rtp")
_SECRET = re.compile("pass|pwd|token|user|auth", re.IGNORECASE)
"""Some cameras take a login within the path."""


def address_fault(url: str) -> str:
    """Why ``url`` can't be a stream's address, empty if it can; never quotes it, since it may hold a password."""
    scheme, separator, rest = url.partition("://")
    if not separator or scheme not in SCHEMES:
        return f"it begins with one of {', '.join(f'{known}://' for known in SCHEMES)}"
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        return "the port must be 1 to 65535; in a password write %40 for @, %3A for :, %2F for /, %23 for #"
    if "@" in rest and "@" not in parts.netloc:
        return "in a password write %40 for @, %3A for :, %2F for /, %23 for #, %3F for ?"
    if scheme in ("udp", "rtp"):
        return "" if port else "the port is missing, e.g. udp://0.0.0.0:5000"
    return "" if parts.hostname else "the host is missing, e.g. rtsp://camera.local/stream1"


def without_login(url: str) -> str:
    """``url`` with ``***`` in the place of user name and password, wherever a camera takes them.

    Cut at the last @, so that a password with characters that it shouldn't hold is hidden too.
    """
    scheme, _, rest = url.partition("://")
    login, _, place = rest.rpartition("@")
    host, slash, path = re.split("[?#]", place, maxsplit=1)[0].partition("/")
    secret = _SECRET.search(path) is not None
    hidden = "***" if secret else path
    return f"{scheme}://{'***@' if login else ''}{host}{slash}{hidden}{'?***' if '?' in place else ''}"


def presentable(options: dict[str, Any]) -> dict[str, Any]:
    """A camera's keys for session.json and anything else that leaves the machine: addresses without login."""
    return {
        key: without_login(value) if isinstance(value, str) and "://" in value else value
        for key, value in options.items()
    }
