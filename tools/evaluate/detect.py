"""`tagmill evaluate detect`: which markers detectors find, on rendered scenes and photographs, or on your own pictures.

Without --folder it is `tagmill bench detect`. With --folder: what each detector finds in your pictures, how many of
these markers the others find there as well, ids that the rig file doesn't know, and the time it takes.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from common.config import load_rig
from common.errors import EXIT_OK, ConfigError
from common.markers import Family
from common.markers import family as open_family
from services.detect.markers.quads import same_place
from tools.bench import detect as bench
from tools.bench.detect_cases import PICTURES, SEARCHED
from tools.bench.detect_rivals import Found, Search, contenders
from tools.report.table import print_table

Grey = NDArray[np.uint8]

_COLUMNS = ("detector", "markers", "confirmed", "missed", "not in rig", "ms", "p95")
_EXPLAINED = (
    "Markers in all pictures; confirmed: those that another maker's detector finds as well, same id, same place; "
    "missed: those that two other makers' detectors agree on; CPU time of a picture, one thread: median and p95."
)


@dataclass
class Finds:
    """One detector over all pictures."""

    markers: int = 0
    confirmed: int = 0
    missed: int = 0
    unknown: int = 0
    times_ms: list[float] = field(default_factory=list)

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "markers": self.markers,
            "confirmed": self.confirmed,
            "missed": self.missed,
            "not_in_rig": self.unknown,
            "ms_median": statistics.median(self.times_ms),
            "ms_p95": float(np.percentile(self.times_ms, 95)),
        }


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The evaluation's own arguments: those of the benchmark, and the folder's."""
    bench.add_parser(parser)
    parser.add_argument("--folder", type=Path, metavar="PICTURES", help="evaluate these pictures instead")
    parser.add_argument("--family", help=f"their markers' family (default: the rig file's, else {SEARCHED})")
    parser.add_argument("--rig", type=Path, default=argparse.SUPPRESS, metavar="FILE", help="whose markers they show")


def run(args: argparse.Namespace) -> int:
    """Evaluate and print."""
    if args.folder is None:
        return bench.run(args)
    cv2.setNumThreads(1)
    searched, known = _searched(args)
    pictures = _pictures(args.folder)
    searches, absent = contenders()
    shown = track(pictures, "searching", console=Console(stderr=True), transient=True, disable=args.json)
    finds, seen = evaluate(((path.name, _grey(path)) for path in shown), searches, searched, known)
    if args.json:
        detectors = {name: item.plain() for name, item in finds.items()}
        print(json.dumps({"evaluation": "detect", "detectors": detectors, "not_installed": absent, "pictures": seen}))
        return EXIT_OK
    console = Console(highlight=False, markup=False)
    title = f"{len(pictures)} pictures of {args.folder}, {searched.name} (cv2 {cv2.__version__})"
    print_table(console, title, _COLUMNS, [_row(name, item, known) for name, item in finds.items()])
    console.print(_EXPLAINED, style="dim")
    if absent:
        console.print(f"not installed: {', '.join(absent)}")
    return EXIT_OK


def evaluate(
    pictures: Iterator[tuple[str, Grey]], searches: dict[str, Search], searched: Family, known: frozenset[int] | None
) -> tuple[dict[str, Finds], dict[str, dict[str, list[int]]]]:
    """All detectors over all pictures in turn, and the ids that each found in each picture.

    ``known`` ids are configured, None: any. Detectors that don't have the family are left out.
    """
    finds: dict[str, Finds] = {}
    ids: dict[str, dict[str, list[int]]] = {}
    for name, grey in pictures:
        if not ids:  # a detector's first search opens it
            for search in searches.values():
                search(grey, searched)
        found: dict[str, Found] = {}
        for detector, search in searches.items():
            began = time.process_time_ns()
            markers = search(grey, searched)
            if markers is not None:
                finds.setdefault(detector, Finds()).times_ms.append((time.process_time_ns() - began) / 1e6)
                found[detector] = markers
        ids[name] = {detector: sorted(marker for marker, _ in markers) for detector, markers in found.items()}
        for detector, markers in found.items():
            others = {other: its for other, its in found.items() if _maker(other) != _maker(detector)}
            _compare(markers, others, finds[detector])
            finds[detector].unknown += 0 if known is None else sum(marker not in known for marker, _ in markers)
    return finds, ids


def _compare(markers: Found, others: dict[str, Found], into: Finds) -> None:
    into.markers += len(markers)
    into.confirmed += sum(any(_holds(its, one) for its in others.values()) for one in markers)
    agreed: Found = []
    for other, its in others.items():
        rest = [theirs for name, theirs in others.items() if _maker(name) != _maker(other)]
        for one in its:
            if any(_holds(theirs, one) for theirs in rest) and not _holds(agreed, one):
                agreed.append(one)
    into.missed += sum(not _holds(markers, one) for one in agreed)


def _maker(detector: str) -> str:
    """Settings of one detector are no witnesses of each other."""
    return "cv2" if detector == "tagmill opencv" else detector.split(" ")[0]


def _holds(markers: Found, one: tuple[int, NDArray[np.float64]]) -> bool:
    return any(marker == one[0] and same_place(corners, one[1]) for marker, corners in markers)


def _searched(args: argparse.Namespace) -> tuple[Family, frozenset[int] | None]:
    """The family to search, and the ids that the rig file knows."""
    if args.rig is None:
        return open_family(args.family or SEARCHED, Path()), None
    rig = load_rig(args.rig)
    known = frozenset(marker.id for box in rig.boxes for _, marker in box.markers())
    if args.family is not None:
        return open_family(args.family, Path()), known
    return open_family(rig.config.markers.family, rig.folder), known


def _pictures(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise ConfigError(f"there is no folder {folder}")
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURES)
    if not found:
        raise ConfigError(f"there are no pictures in {folder} (looked for {', '.join(sorted(PICTURES))})")
    return found


def _grey(path: Path) -> Grey:
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise ConfigError(f"{path} can't be read as a picture")
    return np.asarray(grey, dtype=np.uint8)


def _row(name: str, item: Finds, known: frozenset[int] | None) -> Sequence[str]:
    counts = [item.markers, item.confirmed, item.missed]
    unknown = "-" if known is None else str(item.unknown)
    times = item.plain()
    return [name, *map(str, counts), unknown, f"{times['ms_median']:.1f}", f"{times['ms_p95']:.1f}"]
