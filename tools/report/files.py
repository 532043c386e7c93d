"""Report files for programs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from common.errors import DatasetError


def write_json(document: Mapping[str, Any], path: Path) -> None:
    """Write a document, making its folder."""
    write_text(json.dumps(document, indent=2) + "\n", path)


def write_text(text: str, path: Path) -> None:
    """Write a text file, making its folder; raises DatasetError where that can't be done."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DatasetError(f"the report {path} can't be written: {error.strerror or error}") from error
