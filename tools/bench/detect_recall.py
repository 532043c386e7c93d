"""`tagmill bench detect`: recall and price of marker detectors on real pictures with known markers.

Rivals and ours run in turn over the same pictures, several times; times are ratios to our fast search. The
pictures are those of a folder with a `truth.json` (see --help); missing files are left out and named.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from common.errors import EXIT_OK, ConfigError
from common.markers import Family, family
from services.detect.markers import MarkerDetector, open_detector

Grey = NDArray[np.uint8]
Found = list[tuple[int, NDArray[np.float64]]]
Search = Callable[[Grey, Family], Found]

SAME_PLACE_PX = 6.0
PICTURES = {".jpg", ".jpeg", ".png"}
TYPICAL_PIXELS = 1280 * 720


@dataclass
class Score:
    """One detector on one set: true markers found, unlisted ones with an id of the picture, ids of no marker there."""

    found: int = 0
    markers: int = 0
    unlisted: int = 0
    wrong: int = 0

    def add(self, other: Score) -> None:
        """Sum up."""
        self.found += other.found
        self.markers += other.markers
        self.unlisted += other.unlisted
        self.wrong += other.wrong


@dataclass
class Result:
    """One detector: scores by set, and ms for a picture of 1280x720 in each round."""

    name: str
    sets: dict[str, Score] = field(default_factory=dict)
    rounds_ms: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Case:
    """A picture with its truth."""

    set: str
    grey: Grey
    family: Family
    markers: tuple[dict[str, Any], ...]


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The benchmark's own arguments."""
    default = Path(os.environ.get("TAGMILL_TESTDATA", "../shared/data"))
    parser.add_argument("--data", type=Path, default=default, help=f"folder with truth.json (default {default})")
    parser.add_argument("--rounds", type=int, default=3, help="how often each detector sees each picture (3)")


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    cv2.setNumThreads(1)
    cases, missing = read_cases(args.data)
    results = measure(cases, max(args.rounds, 1))
    if args.json:
        print(json.dumps({"cv2": cv2.__version__, "missing": missing, "detectors": [asdict(r) for r in results]}))
    else:
        show(results, missing)
    return EXIT_OK


def read_cases(data: Path) -> tuple[list[Case], list[str]]:
    """The pictures of ``data/truth.json`` and the names of those that aren't there; raises ConfigError."""
    truth = data / "truth.json"
    if not truth.is_file():
        raise ConfigError(f"there is no {truth}; name the folder with --data or TAGMILL_TESTDATA")
    cases, missing = [], []
    for name, entry in json.loads(truth.read_text()).items():
        path = data / name
        if path.suffix.lower() not in PICTURES:
            continue
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if grey is None:
            missing.append(name)
            continue
        markers = family(entry["dictionary"].split(" ")[0], data)
        cases.append(Case(name.split("/")[0], np.asarray(grey, dtype=np.uint8), markers, tuple(entry["markers"])))
    return cases, missing


def measure(cases: Iterable[Case], rounds: int) -> list[Result]:
    """All detectors over all pictures, interleaved picture by picture."""
    searches = detectors()
    results = {name: Result(name) for name in searches}
    for number in range(rounds):
        spent: dict[str, float] = dict.fromkeys(searches, 0.0)
        pixels: dict[str, int] = dict.fromkeys(searches, 0)
        for case in cases:
            for name, search in searches.items():
                if name.startswith("AprilTag") and not case.family.apriltag:
                    continue
                began = time.perf_counter()
                found = search(case.grey, case.family)
                spent[name] += time.perf_counter() - began
                pixels[name] += case.grey.size
                if number == 0:
                    results[name].sets.setdefault(case.set, Score()).add(score(found, case.markers))
        for name, result in results.items():
            result.rounds_ms.append(spent[name] / max(pixels[name], 1) * TYPICAL_PIXELS * 1e3)
    return list(results.values())


def detectors() -> dict[str, Search]:
    """Ours and the rivals that are installed."""
    table: dict[str, Search] = {
        "tagmill fast": _ours(thorough=False),
        "tagmill thorough": _ours(thorough=True),
        f"cv2 {cv2.__version__} defaults": _cv2_defaults,
    }
    if find_spec("pupil_apriltags") is not None:
        table["AprilTag 3 decimate 1"] = _apriltag(1.0)
    return table


def score(found: Found, markers: Iterable[dict[str, Any]]) -> Score:
    """Compare what was found with what is there; each is used once."""
    left, result = list(found), Score()
    ids = {int(true["id"]) for true in markers}
    for true in markers:
        result.markers += 1
        for index, (marker, corners) in enumerate(left):
            if marker == true["id"] and _near(corners, true):
                left.pop(index)
                result.found += 1
                break
    for marker, _ in left:
        if marker in ids:
            result.unlisted += 1
        else:
            result.wrong += 1
    return result


def _near(corners: NDArray[np.float64], true: dict[str, Any]) -> bool:
    if "corners" not in true:
        return True
    centre = np.mean(np.asarray(true["corners"], dtype=np.float64), axis=0)
    return float(np.linalg.norm(corners.mean(axis=0) - centre)) < SAME_PLACE_PX


def _ours(*, thorough: bool) -> Search:
    opened: dict[str, MarkerDetector] = {}

    def search(grey: Grey, markers: Family) -> Found:
        if markers.name not in opened:
            opened[markers.name] = open_detector(markers, Path(), thorough=thorough)
        return [(one.id, np.array(one.corners)) for one in opened[markers.name].detect(grey)]

    return search


def _cv2_defaults(grey: Grey, markers: Family) -> Found:
    quads, ids, _ = cv2.aruco.ArucoDetector(markers.dictionary).detectMarkers(grey)
    if not len(quads):
        return []
    corners = [np.asarray(quad, dtype=np.float64).reshape(4, 2) for quad in quads]
    return [(int(one), quad) for one, quad in zip(np.asarray(ids).ravel(), corners, strict=True)]


def _apriltag(decimate: float) -> Search:
    from pupil_apriltags import Detector

    # One object for the whole process: several abort at its exit.
    detector = Detector("tag36h11", quad_decimate=decimate)

    def search(grey: Grey, markers: Family) -> Found:
        if markers.name != "apriltag_36h11":
            return []
        # Its first pixel's centre is (0.5, 0.5).
        return [(int(one.tag_id), np.asarray(one.corners) - 0.5) for one in detector.detect(grey)]

    return search


def show(results: list[Result], missing: list[str]) -> None:
    """The table for people."""
    sets = list(results[0].sets)
    table = Table(title=f"Markers found of those known (cv2 {cv2.__version__}); +n unlisted, !n wrong ids")
    table.add_column("detector")
    for name in [*sets, "all", "ms at 1280x720", "time against ours"]:
        table.add_column(name, justify="right")
    for result in results:
        total = Score()
        for part in result.sets.values():
            total.add(part)
        ratios = [mine / ours for mine, ours in zip(result.rounds_ms, results[0].rounds_ms, strict=True)]
        spread = f"{statistics.median(ratios):.2f} ({min(ratios):.2f}-{max(ratios):.2f})"
        cells = [_cell(result.sets.get(name)) for name in sets]
        table.add_row(result.name, *cells, _cell(total), f"{statistics.median(result.rounds_ms):.1f}", spread)
    console = Console(highlight=False)
    console.print(table)
    if missing:
        console.print("not there: " + ", ".join(missing))


def _cell(score: Score | None) -> str:
    if score is None:
        return "-"
    unlisted = f" +{score.unlisted}" if score.unlisted else ""
    wrong = f" !{score.wrong}" if score.wrong else ""
    return f"{score.found}/{score.markers}{unlisted}{wrong}"


if __name__ == "__main__":
    alone = argparse.ArgumentParser(description=__doc__)
    add_parser(alone)
    alone.add_argument("--json", action="store_true")
    try:
        code = run(alone.parse_args())
    except ConfigError as error:
        raise SystemExit(error.message) from None
    raise SystemExit(code)
