"""The page's files: a table made from the folder ``static``; nothing from outside becomes a path."""

from __future__ import annotations

import base64
import hashlib
import mimetypes
import re
from pathlib import Path
from typing import NamedTuple

STATIC = Path(__file__).with_name("static")
INDEX = "index.html"
_TYPES = {
    ".html": "text/html",
    ".js": "text/javascript",
    ".mjs": "text/javascript",
    ".css": "text/css",
    ".svg": "image/svg+xml",
}
_INLINE = re.compile(rb"<script(?![^>]*\bsrc=)[^>]*>(.*?)</script>", re.DOTALL)


class StaticFile(NamedTuple):
    """A file with its media type."""

    path: Path
    media_type: str


class Page:
    """The files below ``folder`` by their names as in an address; ``hashes`` are those of index.html's own scripts."""

    def __init__(self, folder: Path = STATIC) -> None:
        self.files = {
            path.relative_to(folder).as_posix(): StaticFile(path, _media_type(path))
            for path in sorted(folder.rglob("*"))
            if path.is_file() and not path.name.startswith(".")
        }
        self._hashed: tuple[int, tuple[str, ...]] = (0, ())

    @property
    def index(self) -> StaticFile | None:
        """The one page, None where the files are missing."""
        return self.files.get(INDEX)

    def hashes(self) -> tuple[str, ...]:
        """base64 SHA-256 of each inline script of the page (its import map), computed anew when the file changes."""
        if self.index is None:
            return ()
        changed_ns = self.index.path.stat().st_mtime_ns
        if self._hashed[0] != changed_ns:
            found = _INLINE.findall(self.index.path.read_bytes())
            self._hashed = (changed_ns, tuple(base64.b64encode(hashlib.sha256(one).digest()).decode() for one in found))
        return self._hashed[1]


def _media_type(path: Path) -> str:
    return _TYPES.get(path.suffix) or mimetypes.guess_type(path.name)[0] or "application/octet-stream"
