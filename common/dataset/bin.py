"""The bin of a session: ``<session>/bin/`` has the session's folders and holds the samples that were deleted.

A sample is where its label is. So a label leaves the session *first* (then the sample is deleted, whatever happens
to its pictures next) and comes back *last* (then all of it is there). After a kill, `settle` brings the pictures to
their label: a delete that was begun is finished, a restore that had not brought the label back is taken back.

Whoever moves holds the session's lock (`common.dataset.locks`).
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from common.dataset.durable import make_folder, sync_folder
from common.dataset.layout import (
    BIN,
    FOLDERS,
    LABELS,
    PICTURES,
    label_path,
    sample_of_label,
    sample_of_picture,
)
from common.errors import RefusedError

NO_SAMPLE = "no_sample"
_SHOWN = 5


@dataclass
class Settled:
    """The bin after a start: ``samples`` in it; ``moved`` files of moves that a kill had cut off; ``twice``: samples
    of which the session and the bin have each a label of its own (somebody copied it): both are left alone.
    """

    samples: set[str] = field(default_factory=set)
    moved: list[str] = field(default_factory=list)
    twice: list[str] = field(default_factory=list)


def bin_of(session: Path) -> Path:
    """The bin's folder; it is made by the first delete."""
    return session / BIN


def labelled(folder: Path) -> set[str]:
    """The samples whose label is in a session's folder, or in a bin's."""
    return {sample for name in names_in(folder / LABELS) if (sample := sample_of_label(name)) is not None}


def delete(session: Path, samples: Collection[str]) -> tuple[str, ...]:
    """Move samples to the bin, durably: all of them, or none if that fails. Returns those that were not there already.

    Raises RefusedError ``no_sample`` if the session has none of that name, OSError.
    """
    new = _to_move(session, samples, session, bin_of(session))
    if new:
        make_folder(bin_of(session) / LABELS)
    moves = _Moves(session)
    with moves:
        moves.labels(new, session, bin_of(session))
        moves.pictures(new, session, bin_of(session))
    return new


def restore(session: Path, samples: Collection[str]) -> tuple[str, ...]:
    """Put samples back from the bin, durably: all of them, or none if that fails. Returns those that were not back.

    Raises RefusedError ``no_sample`` if the bin has none of that name, OSError.
    """
    new = _to_move(session, samples, bin_of(session), session)
    moves = _Moves(session)
    with moves:
        moves.pictures(new, bin_of(session), session)
        moves.labels(new, bin_of(session), session)
    return new


def settle(session: Path) -> Settled:
    """Bring every picture to its label, durably; raises OSError. To be called before half-written ones are removed."""
    found = Settled()
    trash = bin_of(session)
    if not trash.is_dir():
        return found
    there = labelled(session)
    for sample in sorted(labelled(trash)):
        if sample not in there:
            found.samples.add(sample)
        elif (session / label_path(sample)).samefile(trash / label_path(sample)):
            # A file system that was cut off between a rename's two halves: it was not answered for, so it stays.
            (trash / label_path(sample)).unlink()
        else:
            found.twice.append(sample)
    alone = found.samples - set(found.twice)
    moves = _Moves(session)
    with moves:
        moves.pictures(alone, session, trash)
        moves.pictures(there - set(found.twice), trash, session)
    found.moved = [str(source.relative_to(session)) for source, _ in moves.done]
    for folder in (session, trash):
        # What was moved before a kill but not yet answered for is answered for from now on.
        _sync(folder / name for name in FOLDERS)
    return found


def _to_move(session: Path, samples: Iterable[str], source: Path, target: Path) -> tuple[str, ...]:
    """Those that are at the source, each once; raises RefusedError for those that are in neither place."""
    wanted = dict.fromkeys(samples)
    there = [sample for sample in wanted if (target / label_path(sample)).exists()]
    new = tuple(sample for sample in wanted if sample not in there and (source / label_path(sample)).exists())
    unknown = [sample for sample in wanted if sample not in there and sample not in new]
    if unknown:
        raise no_sample(session, unknown)
    return new


def no_sample(session: Path, unknown: Collection[str]) -> RefusedError:
    """The refusal for samples that a session doesn't have."""
    shown = ", ".join(sorted(unknown)[:_SHOWN]) + (
        f" and {len(unknown) - _SHOWN} more" if len(unknown) > _SHOWN else ""
    )
    return RefusedError(f"session {session.name} has no sample {shown}; nothing was moved", code=NO_SAMPLE)


class _Moves:
    """Renames within a session, each durable at the end of its step; an OSError takes all of them back."""

    def __init__(self, session: Path) -> None:
        self._session = session
        self.done: list[tuple[Path, Path]] = []

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            return
        # What can't be taken back on a broken disk is settled at the next start; the first error counts.
        with contextlib.suppress(OSError):
            for source, target in reversed(self.done):
                target.rename(source)
            _sync({path.parent for move in self.done for path in move})

    def labels(self, samples: Iterable[str], source: Path, target: Path) -> None:
        paths = [label_path(sample) for sample in samples]
        self._move([(source / path, target / path) for path in paths])

    def pictures(self, samples: Collection[str], source: Path, target: Path) -> None:
        """All files that are named as the samples' pictures, whatever their format: a damaged label names none."""
        if not samples:
            return
        wanted = set(samples)
        for kind in PICTURES:
            names = [name for name in names_in(source / kind) if sample_of_picture(kind, name) in wanted]
            if names:
                make_folder(target / kind)
            self._move([(source / kind / name, target / kind / name) for name in names])

    def _move(self, moves: list[tuple[Path, Path]]) -> None:
        for source, target in moves:
            if not target.exists():
                source.rename(target)
                self.done.append((source, target))
            elif target.samefile(source):  # both halves of a rename that was cut off; rename itself would do nothing
                source.unlink()
        # First the names that are new: a power cut in between leaves two names for a file, never none.
        for end in (1, 0):
            _sync({move[end].parent for move in moves})


def _sync(folders: Iterable[Path]) -> None:
    for folder in folders:
        if folder.is_dir():
            sync_folder(folder)


def names_in(folder: Path) -> list[str]:
    """The names of what is in a folder; none if there is no such folder. Raises OSError."""
    try:
        with os.scandir(folder) as entries:
            return [entry.name for entry in entries]
    except FileNotFoundError:
        return []
