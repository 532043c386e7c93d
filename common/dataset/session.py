"""``session.json``: the rig, the cameras and the ledger of one session."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, ValidationError

from common import VERSION
from common.bounded import parse_json, read_bytes
from common.dataset.layout import SESSION_FILE
from common.errors import DatasetError
from common.labels import CameraLabel, Part
from common.ledgers import CameraLedger, Ledger

P = TypeVar("P", bound=Part)

MOST_BYTES = 256 << 20
"""Of a label or a session.json; ten thousand recordings are 10 MiB."""
SESSION_SCHEMA: Literal["tagmill.session/1"] = "tagmill.session/1"

_PACKAGES = ("opencv-contrib-python-headless", "numpy", "pydantic", "pyzmq")


class SessionCamera(Part):
    """A camera as it was from ``since`` (ISO UTC) on; ``depth_unit_mm`` is mm a step, None without depth."""

    since: str
    camera: CameraLabel
    depth_unit_mm: float | None = None
    driver: str | None = None
    fps: float | None = None


class StackLife(Part):
    """One life of a stack: its supervisor's process. A recording goes on only in the life that began it.

    ``started`` is the process's start in clock ticks since the machine's boot, ``machine_boot`` that boot's id;
    so a process id that is used again is no mistake.
    """

    pid: int
    started: int
    machine_boot: str


class RecordingProgress(Part):
    """What the store must remember of a recording beside its ledger: whose it is, which cameras have ended."""

    life: StackLife
    ended: tuple[str, ...] = ()


class SessionFile(Part):
    """The whole of ``session.json``. ``cameras`` holds every description a camera had, the newest last.

    ``records`` sums up, by camera, the single requests, whose ledgers are the lines of ``records.jsonl``.
    """

    schema_: Annotated[Literal["tagmill.session/1"], Field(alias="schema")] = SESSION_SCHEMA
    name: str
    created_at: str
    rig: dict[str, Any]
    versions: dict[str, str]
    cameras: dict[str, tuple[SessionCamera, ...]] = {}
    recordings: dict[str, Ledger] = {}
    progress: dict[str, RecordingProgress] = {}
    records: dict[str, CameraLedger] = {}

    def to_bytes(self) -> bytes:
        """As it is written to the disk (pretty printed UTF-8 JSON)."""
        return self.model_dump_json(by_alias=True, indent=1).encode() + b"\n"


def read_session(folder: Path) -> SessionFile:
    """Read a session's ``session.json``; raises DatasetError that says what is wrong and where."""
    path = folder / SESSION_FILE
    return parse_versioned(SessionFile, read_text(path), path)


def read_text(path: Path) -> str:
    """A text file of a dataset; raises DatasetError if it isn't there or can't be read."""
    try:
        return read_bytes(path, MOST_BYTES).decode()
    except FileNotFoundError:
        raise DatasetError(f"{path} is missing", code="missing_file") from None
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path} can't be read: {error}") from error


def parse_versioned(kind: type[P], text: str, path: Path) -> P:
    """Read a JSON text with a ``schema`` field as ``kind``.

    Raises DatasetError (code ``other_schema``) for a schema this tagmill doesn't know, else naming the wrong field.
    """
    try:
        plain = parse_json(text)
    except ValueError as error:
        raise DatasetError(f"{path} is not JSON ({error}); it is damaged or not tagmill's") from error
    known = kind.model_fields["schema_"].default
    found = plain.get("schema") if isinstance(plain, dict) else None
    if found != known:
        raise DatasetError(
            f"{path} has schema {found!r}, this tagmill reads {known!r}; use the tagmill that wrote it, or a newer one",
            code="other_schema",
        )
    try:
        return kind.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise DatasetError(f"{path}: {where}: {first['msg']}") from error


def versions_now() -> dict[str, str]:
    """The versions of what makes samples, as ``session.json`` names them."""
    found = {"tagmill": VERSION, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "unknown"
    return found
