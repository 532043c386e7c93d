"""``tagmill-export.json``: what an export is, and every file of it. Written before the first file and after the last.

So a folder is known as an export from the start, a run that was cut off is gone on with, and one that is complete is
left as it is. A file is kept if the manifest knows its key and it has the size it had.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from common.bounded import parse_json
from common.dataset import write_bytes
from common.errors import RefusedError

MANIFEST = "tagmill-export.json"
SCHEMA = "tagmill.export/1"


@dataclass
class Manifest:
    """``files``: path to key and size in bytes (None: not written yet). ``stated``: what the export is."""

    complete: bool = False
    stated: Mapping[str, Any] = field(default_factory=dict)
    samples: Mapping[str, Any] = field(default_factory=dict)
    files: dict[str, tuple[str, int | None]] = field(default_factory=dict)

    def to_bytes(self) -> bytes:
        """As it is written: what it is in full, then a line for each sample and each file."""
        stated = {"schema": SCHEMA, "complete": self.complete, **self.stated}
        head = json.dumps(stated, ensure_ascii=False, indent=1).removesuffix("\n}")
        samples, files = _lines(self.samples), _lines(dict(sorted(self.files.items())))
        return f'{head},\n "samples": {{\n{samples}\n }},\n "files": {{\n{files}\n }}\n}}\n'.encode()

    def write(self, folder: Path) -> None:
        """Write it durably, unless the very same is there; raises OSError."""
        data, path = self.to_bytes(), folder / MANIFEST
        if not path.exists() or path.read_bytes() != data:
            write_bytes(path, data)

    @classmethod
    def read(cls, folder: Path) -> Manifest | None:
        """The export that lies in ``folder``; None if the folder is empty or not there.

        Raises RefusedError for a folder that has something else in it, or is no folder.
        """
        if folder.exists() and not folder.is_dir():
            raise RefusedError(f"{folder} is a file; --out names a folder", code="bad_out")
        if not folder.exists() or not any(folder.iterdir()):
            return None
        try:
            plain = parse_json((folder / MANIFEST).read_bytes())
            if plain["schema"] != SCHEMA:
                raise RefusedError(
                    f"{folder} was exported by another tagmill ({plain['schema']}); choose another folder",
                    code="bad_out",
                )
            files = {str(path): (str(key), size) for path, (key, size) in plain["files"].items()}
        except FileNotFoundError:
            raise RefusedError(
                f"{folder} is not empty and no export of tagmill's; nothing there is touched, choose another folder",
                code="bad_out",
            ) from None
        except (ValueError, KeyError, TypeError) as error:
            raise RefusedError(
                f"{folder / MANIFEST} is damaged ({error!r}); choose another folder, or remove this one", code="bad_out"
            ) from error
        known = ("schema", "complete", "samples", "files")
        stated = {key: value for key, value in plain.items() if key not in known}
        return cls(bool(plain["complete"]), stated, plain["samples"], files)


def _lines(rows: Mapping[str, Any]) -> str:
    """A line for each: Python's own encoder, which alone can indent, would take a tenth of a small export's time."""
    line = json.JSONEncoder(ensure_ascii=False).encode
    return ",\n".join(f"  {line(key)}: {line(value)}" for key, value in rows.items())
