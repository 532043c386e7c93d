"""What is in a session: counts, coverage, quality, and the samples that look wrong, the most suspicious first.

Writes a report (HTML) and, with --json, prints everything. --verify only opens every file and compares it with its
label (exit code 5 if anything is wrong); --repair moves what is broken away, to where it can be brought back from.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

from common.dataset import SessionFile, SessionReader
from common.dataset.boxes import boxes_of
from common.dataset.faults import explain
from common.errors import EXIT_FOUND, EXIT_OK, ConfigError, DatasetError, RefusedError
from common.markers import family
from tools.dataset.place import chosen, named_session
from tools.inspect.crew import look_at
from tools.inspect.facts import BROKEN, STRAY, Facts, Problem, Suspect
from tools.inspect.files import ledger_problems, stray_files
from tools.inspect.measure import Job
from tools.inspect.page import report
from tools.inspect.repair import Repaired, repair
from tools.inspect.summary import Summary, summarise
from tools.inspect.suspicion import suspects
from tools.report.table import print_table

REPORT = "report.html"
_TOP = 30
_SHOWN = 10


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which session, and what is wanted of it."""
    parser.description = __doc__
    parser.add_argument("session", metavar="SESSION", help="a session's name below dataset.root, or its folder")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="where the report goes (default: inspect-SESSION in this folder)"
    )
    parser.add_argument("--top", type=int, default=_TOP, help=f"list so many suspicious samples (default {_TOP})")
    parser.add_argument("--verify", action="store_true", help="only the files: exit code 5 if anything is wrong")
    parser.add_argument("--repair", action="store_true", help="as --verify, and move what is broken away")


def run(args: argparse.Namespace) -> int:
    """Look at the session; returns the exit code."""
    if args.top < 1:
        raise RefusedError("--top must be 1 or more", code="out_of_bounds")
    folder = named_session(args)
    reader = SessionReader(folder)
    return _verify(args, reader) if args.verify or args.repair else _inspect(args, reader)


def _inspect(args: argparse.Namespace, reader: SessionReader) -> int:
    console = Console(highlight=False)
    session = reader.session
    notes: list[str] = []
    facts = look_at(_job(reader, session, notes), reader.samples(), quiet=args.json)
    if not facts:
        raise RefusedError(f"session {reader.folder.name} has no sample yet; record some first", code="no_sample")
    in_bin = len(reader.bin.samples()) if reader.bin is not None else 0
    summary = summarise(facts, session, reader.folder.resolve().name, in_bin)
    found = suspects(facts)
    page = report(reader, summary, facts, found, args.top)
    for note in notes:
        page.note(note)
    path = (args.out or Path(f"inspect-{summary.name}")) / REPORT
    page.write(path)
    if args.json:
        print(json.dumps(_document(summary, facts, found, path, notes)))
        return EXIT_OK
    _show(console, summary, found, min(args.top, _SHOWN))
    for note in notes:
        console.print(note)
    console.print(f"The report: {path}", soft_wrap=True)
    return EXIT_OK


def _job(reader: SessionReader, session: SessionFile, notes: list[str]) -> Job:
    """With the rig of the session; what can't be looked for is noted."""
    boxes = boxes_of(session, reader.folder)
    name = (session.rig.get("markers") or {}).get("family")
    try:
        if name is not None:
            family(str(name), reader.folder)
    except ConfigError:
        notes.append(
            f"Markers that remain were not looked for: the session names the family '{name}', which isn't here."
        )
        name = None
    return Job(reader.folder, boxes, name)


def _show(console: Console, summary: Summary, found: Sequence[Suspect], shown: int) -> None:
    bad = [one for one in found if one.reasons]
    console.print(
        f"[bold]{summary.name}[/]: {summary.samples} samples, {summary.bytes / 1e6:.0f} MB, {summary.in_bin} in the "
        f"bin; {summary.duplicates} near-duplicates"
    )
    counts = [*summary.by_camera.items(), *summary.by_object.items(), *summary.by_class.items()]
    console.print("  " + ", ".join(f"{name} {count}" for name, count in counts))
    wrong = [row for row in summary.ledger if not row["adds_up"] and row["phase"] in ("ended", "interrupted")]
    console.print(f"  the ledger {'adds up' if not wrong else f'does not add up for {len(wrong)} recordings'}")
    if summary.erased:
        rows = [
            [name, f"{one.median:.0%}", f"{one.low:.0%}", f"{one.high:.0%}"] for name, one in summary.erased.items()
        ]
        print_table(console, "erased share of windows", ["class", "median", "5 %", "95 %"], rows)
    if not bad:
        console.print("No sample stands out.")
        return
    console.print(f"[bold]{len(bad)} look suspicious[/]" + (f", the first {shown}:" if len(bad) > shown else ":"))
    for one in bad[:shown]:
        console.print(f"  {one.score:5.1f}  {one.facts.sample}  {one.reasons[0].text}", soft_wrap=True)


def _document(
    summary: Summary, facts: Sequence[Facts], found: Sequence[Suspect], path: Path, notes: Sequence[str]
) -> dict[str, Any]:
    return {
        "ok": True,
        "report": str(path),
        "notes": list(notes),
        "summary": asdict(summary) | {"alike": [[facts[index].sample for index in group] for group in summary.alike]},
        "suspicious": [
            {"sample": one.facts.sample, "score": round(one.score, 3), "reasons": [asdict(why) for why in one.reasons]}
            for one in found
            if one.reasons
        ],
    }


def _verify(args: argparse.Namespace, reader: SessionReader) -> int:
    problems, samples = _problems(reader, quiet=args.json)
    moved: Repaired | None = None
    if args.repair and any(one.kind in (*BROKEN, *STRAY) for one in problems):
        with chosen(args) as place:
            moved = repair(place, problems)
    if args.json:
        _print_verified(reader, problems, samples, moved)
    else:
        _tell(reader, problems, samples, moved, asked=args.repair)
    gone = moved is not None and moved.left is None
    left = [one for one in problems if not (gone and one.kind in (*BROKEN, *STRAY))]
    return EXIT_FOUND if left else EXIT_OK


def _problems(reader: SessionReader, *, quiet: bool) -> tuple[list[Problem], int]:
    """All that is wrong with a session's files, and how many samples were opened."""
    found: list[Problem] = []
    boxes: tuple[Any, ...] = ()
    try:
        boxes = boxes_of(reader.session, reader.folder)
    except DatasetError as error:
        found.append(Problem("session", None, "session.json", error.message))
    facts = look_at(Job(reader.folder, boxes, None, pictures=False), reader.samples(), quiet=quiet)
    for one in facts:
        # Without the rig nothing can contradict it.
        found += [problem for problem in one.problems if boxes or problem.kind != "contradiction"]
    recorded = Counter(one.recording for one in facts if one.recording is not None)
    try:
        found += stray_files(reader.folder)
        if all(one.readable for one in facts):
            found += [problem for problem in ledger_problems(reader, dict(recorded)) if problem.kind != "session"]
    except OSError as error:
        told = explain(error, reader.folder)
        raise DatasetError(told.message, code=told.code) from error
    return found, len(facts)


def _print_verified(reader: SessionReader, problems: Sequence[Problem], samples: int, moved: Repaired | None) -> None:
    document: dict[str, Any] = {
        "ok": not problems,
        "session": reader.folder.name,
        "samples": samples,
        "problems": [asdict(one) for one in problems],
    }
    if moved is not None:
        where = None if moved.quarantine is None else str(moved.quarantine)
        document["moved"] = {"samples": moved.samples, "files": moved.files, "quarantine": where, "left": moved.left}
    print(json.dumps(document))


def _tell(
    reader: SessionReader, problems: Sequence[Problem], samples: int, moved: Repaired | None, *, asked: bool
) -> None:
    console = Console(highlight=False, soft_wrap=True)
    for one in problems:
        console.print(f"{one.kind:13s} {one.message}", markup=False)
    name = reader.folder.resolve().name
    if not problems:
        console.print(f"{samples} samples of {name}: every file opens and is what its label says")
        return
    console.print(f"{samples} samples of {name}: {len(problems)} problems")
    if moved is None:
        can = any(one.kind in (*BROKEN, *STRAY) for one in problems)
        if asked:
            console.print("Nothing was moved: what is wrong is in labels that can be read, or in session.json")
        elif can:
            console.print(f"'tagmill inspect {name} --repair' moves what is broken to the bin")
        return
    if moved.samples:
        names = " ".join(moved.samples[:3]) + (" ..." if len(moved.samples) > 3 else "")
        what = "1 broken sample is" if len(moved.samples) == 1 else f"{len(moved.samples)} broken samples are"
        console.print(f"{what} in the bin; 'tagmill dataset restore --session {name} {names}' puts them back")
    if moved.quarantine is not None:
        console.print(f"{len(moved.files)} files without a sample are in {moved.quarantine}; move them back to undo it")
    if moved.left is not None:
        console.print(moved.left)
