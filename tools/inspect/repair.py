"""`inspect --repair`: what is broken leaves the session, and can come back.

A broken sample goes to the session's bin. A file that belongs to no sample goes to ``quarantine/<time>/``, where it
keeps its folder and name. Nothing is removed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from common.clock import iso_utc, wall_ns
from common.dataset import make_folder, sync_folder
from common.errors import RefusedError
from tools.dataset.place import InFolder, OverSocket
from tools.inspect.facts import BROKEN, STRAY, Problem

QUARANTINE = "quarantine"


@dataclass(frozen=True)
class Repaired:
    """What was moved; ``quarantine``: where stray files are now; ``left``: why some were left where they are."""

    samples: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    quarantine: Path | None = None
    left: str | None = None


def repair(place: InFolder | OverSocket, problems: Sequence[Problem]) -> Repaired:
    """Move broken samples and stray files away; raises RefusedError, NoAnswerError.

    A session that a running stack has open is its store's: broken samples are moved by it, stray files are left
    alone, since one that has no label *yet* looks the same.
    """
    samples = tuple(dict.fromkeys(one.sample for one in problems if one.kind in BROKEN and one.sample is not None))
    files = tuple(one.path for one in problems if one.kind in STRAY)
    if samples:
        answer = place.move("delete", list(samples))
        if not answer["ok"]:
            error = answer["error"]
            raise RefusedError(error["message"], code=error["code"])
    if not files:
        return Repaired(samples)
    if isinstance(place, OverSocket):
        left = f"{len(files)} files without a label were left: the running stack may be about to write their labels"
        return Repaired(samples, left=left)
    folder = place.folder
    target = folder / QUARANTINE / iso_utc(wall_ns()).replace(":", "").replace("-", "")
    place.locked(lambda: _move(folder, target, files))
    return Repaired(samples, files, target)


def _move(folder: Path, target: Path, files: Sequence[str]) -> None:
    for name in files:
        there = target / name
        make_folder(there.parent)
        (folder / name).rename(there)
        sync_folder(there.parent)
        sync_folder((folder / name).parent)
