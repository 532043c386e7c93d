"""A session made again as another one: on all cores, and a run that was cut off is gone on with."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from common.bounded import parse_json, read_bytes
from common.dataset import SessionFile, SessionReader, label_path, make_folder, write_json
from common.dataset.derive import SESSION_EXISTS, making
from common.dataset.derived_session import describe_session
from common.dataset.faults import explain
from common.dataset.head import recording_of
from common.dataset.session import versions_now
from common.dataset.snapshot import Snapshot
from common.errors import DatasetError, RefusedError, TagmillError
from common.service.crew import Crew, Failure
from services.store.disk import RESERVE_BYTES, require_room
from tools.relabel.recipe import Recipe
from tools.relabel.remake import Job, Remade, prepare, work

RELABEL_FILE = "relabel.json"
"""In the new session: of what and by what it was made, so that a second run knows that nothing is to be done."""
_ALONE = 8
"""Fewer samples are made before a second process has started."""
_LARGEST_NOTE = 1 << 20
_LIMIT_S = 300.0
_LOOK_S = 1.0
Tick = Callable[[], None]


@dataclass
class Done:
    """What became of the samples: ``made`` (``before``: of them by an earlier run), others by reason with sentences."""

    target: Path
    made: int = 0
    before: int = 0
    unchanged: bool = False
    left_out: Counter[str] = field(default_factory=Counter)
    sentences: dict[str, str] = field(default_factory=dict)


def relabel(folder: Path, target: Path, recipe: Recipe, begin: Callable[[int], Tick]) -> Done:
    """Make the session ``target`` of the one in ``folder``; ``begin`` is told how many samples are to be made.

    Raises RefusedError (``no_original``, ``session_exists``, ``session_busy``, ``disk_full``, ...), DatasetError.
    """
    reader = SessionReader(folder)
    samples = reader.samples()
    made_of = {"session": folder.resolve().name, "recipe": recipe.fingerprint(), "samples": _digest(folder, samples)}
    if target.exists():
        return _as_it_is(target, made_of)
    usable = _with_original(reader, samples)
    try:
        with making(target, [folder], goes_on=lambda staging: _note(staging) == made_of) as staging:
            return _make(reader, staging, target, recipe, made_of, samples, usable, begin)
    except OSError as error:
        told = explain(error, target.parent)
        raise RefusedError(told.message, code=told.code) from error


def _as_it_is(target: Path, made_of: dict[str, Any]) -> Done:
    note = _note(target)
    if note != made_of:
        raise RefusedError(
            f"there is a session {target.name} in {target.parent} already, and it was made of other samples or by "
            "another rig, calibration or version; remove it, or choose another name (--into)",
            code=SESSION_EXISTS,
        )
    made = len(SessionReader(target).samples())
    return Done(target, made=made, before=made, unchanged=True)


def _with_original(reader: SessionReader, samples: Sequence[str]) -> list[str]:
    """Those whose original was kept; the labels themselves are read by the workers."""
    originals = reader.folder / "original"
    there = {path.stem.removeprefix("original_") for path in originals.iterdir()} if originals.is_dir() else set()
    found = [sample for sample in samples if sample in there]
    if not found:
        raise RefusedError(
            f"{reader.folder.name} has no originals: it was recorded without 'dataset: {{keep_original: true}}', "
            "so the pixels under its markers are gone; record with that to be able to relabel",
            code="no_original",
        )
    return found


def _make(
    reader: SessionReader,
    staging: Path,
    target: Path,
    recipe: Recipe,
    made_of: dict[str, Any],
    samples: Sequence[str],
    usable: Sequence[str],
    begin: Callable[[int], Tick],
) -> Done:
    for name in ("rgb", "depth", "label"):
        make_folder(staging / name)
    write_json(staging / RELABEL_FILE, made_of)
    done = Done(target)
    without = set(samples) - set(usable)
    if without:
        done.left_out["no_original"] = len(without)
        done.sentences[min(without)] = "it was recorded without its original"
    to_make = [sample for sample in usable if not (staging / label_path(sample)).exists()]
    done.before = done.made = len(usable) - len(to_make)
    require_room(staging, _need(reader.folder, to_make), RESERVE_BYTES)
    for one in _all_cores(Job(reader.folder, staging, target.name, recipe), to_make, begin(len(to_make))):
        if one.code is None:
            done.made += 1
        else:
            done.left_out[one.code] += 1
            done.sentences[one.sample] = one.message or one.code
    if not done.made:
        first, why = next(iter(done.sentences.items()))
        raise RefusedError(f"no sample of {reader.folder.name} could be made again; {first}: {why}", code="no_sample")
    taken = {sample: recording_of(staging, sample) for sample in SessionReader(staging).samples()}
    before = Snapshot(reader.folder)
    describe_session(staging, target.name, [before], taken, whole=True, describe=lambda file: _described(file, recipe))
    return done


def _described(file: SessionFile, recipe: Recipe) -> SessionFile:
    """``session.json`` with the new rig, and each camera as the new labels have it."""
    cameras = {
        name: tuple(one.model_copy(update={"camera": recipe.camera(one.camera)}) for one in described)
        for name, described in file.cameras.items()
    }
    return file.model_copy(update={"rig": recipe.plain, "cameras": cameras, "versions": versions_now()})


def _all_cores(job: Job, samples: Sequence[str], tick: Tick) -> list[Remade]:
    """Every sample's outcome; raises what ends the whole. What is done stays done then, and on Ctrl-C."""
    if not samples:
        return []
    found: list[Remade] = []
    if len(samples) < _ALONE:
        prepare(job)
        for sample in samples:
            found.append(_outcome(sample, work(sample)))
            tick()
        return found
    cores = min(len(os.sched_getaffinity(0)), len(samples))
    crew: Crew[str, Remade | TagmillError | OSError] = Crew(work, prepare, (job,), workers=cores, limit_s=_LIMIT_S)
    try:
        for sample in samples:
            crew.submit(sample, sample)
        while crew.busy:
            wait(list(crew.sockets), _LOOK_S)
            for sample, result in crew.finished():
                found.append(_outcome(sample, result))
                tick()
    finally:
        crew.close()
    return found


def _outcome(sample: str, result: Remade | TagmillError | OSError | Failure) -> Remade:
    if isinstance(result, Failure):
        raise DatasetError(
            f"{sample} could not be made again ({result.fault}); what was made before is kept: the same command goes "
            f"on from there. {result.what.strip().splitlines()[-1]}"
        )
    if isinstance(result, TagmillError | OSError):
        raise result
    return result


def _need(folder: Path, samples: Sequence[str]) -> int:
    """About how many bytes the new pictures and labels take; depth and originals are linked."""
    paths = [folder / "rgb" / f"rgb_{sample}.png" for sample in samples]
    return sum(path.stat().st_size + 40_000 for path in paths if path.exists())


def _digest(folder: Path, samples: Sequence[str]) -> str:
    """Of all labels, and so of the pictures whose checksums they hold."""
    digest = hashlib.sha256()
    for sample in samples:
        digest.update(hashlib.sha256((folder / label_path(sample)).read_bytes()).digest())
    return digest.hexdigest()


def _note(folder: Path) -> object:
    """What an earlier run noted in a folder; None without such a note."""
    try:
        return parse_json(read_bytes(folder / RELABEL_FILE, _LARGEST_NOTE))
    except (FileNotFoundError, ValueError):
        return None
