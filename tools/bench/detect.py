"""`tagmill bench detect`: recall, wrong ids, corners and price of marker detectors, ours and others', in one run.

All look at the same pictures in turn: 24 reference scenes, twelve rendered difficulties, photographs with known
markers, and pictures without any. Times are CPU time with cv2 on one thread; compare them only within a run.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import cv2
import numpy as np

from common.errors import EXIT_OK
from common.messages import DetectedMarker
from services.detect.markers.quads import as_quad
from services.label.refine import refine
from tools.bench.detect_cases import EMPTY, REFERENCE, Case, Corners, TrueMarker, marker_free, photographs, rendered
from tools.bench.detect_rivals import OURS, Found, Search, contenders
from tools.bench.detect_table import as_plain, show
from tools.bench.detect_tracking import track

SAME_PLACE_PX = 6.0
TYPICAL_PIXELS = 1280 * 720
REFINED = "tagmill auto, refined"


@dataclass
class Score:
    """One detector on one row. ``unlisted`` finds have an id that is in the picture, ``wrong`` ones have not."""

    pictures: int = 0
    markers: int = 0
    found: int = 0
    unlisted: int = 0
    wrong: int = 0
    errors_px: list[float] = field(default_factory=list)
    times_ms: list[list[float]] = field(default_factory=list)
    """For each picture its times, scaled to 1280x720 pixels."""


NO_PHOTOGRAPHS = "photographs (--data names their folder)"

Scores = dict[str, dict[str, Score]]
"""Detector to row to score."""


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The benchmark's own arguments."""
    parser.add_argument(
        "--data",
        type=Path,
        default=os.environ.get("TAGMILL_TESTDATA") or None,
        metavar="DIR",
        help="photographs with their truth.json (default: TAGMILL_TESTDATA; without either, rendered pictures alone)",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the rendered scenes (1)")
    parser.add_argument("--scenes", type=int, default=6, help="rendered scenes a difficulty, of 8 markers each (6)")
    parser.add_argument("--rounds", type=int, default=3, help="how often each sees the reference scenes and photos (3)")


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    cv2.setNumThreads(1)
    searches, absent = contenders()
    photos, missing = photographs(args.data) if args.data is not None else ([], [NO_PHOTOGRAPHS])
    cases = chain(rendered(args.seed, args.scenes), photos, marker_free(args.data, args.seed, 5 * args.scenes))
    scores = measure(cases, searches, max(args.rounds, 1))
    tracked = track(args.data, args.seed)
    if args.json:
        print(json.dumps(as_plain(scores, tracked, absent, missing)))
    else:
        show(scores, tracked, absent, missing)
    return EXIT_OK


def measure(cases: Iterable[Case], searches: dict[str, Search], rounds: int) -> Scores:
    """All detectors over all pictures, interleaved picture by picture."""
    scores: Scores = {name: {} for name in searches}
    for case in cases:
        again = rounds if case.row == REFERENCE or (case.row != EMPTY and not case.rendered) else 1
        for turn in range(again):
            for name, search in searches.items():
                began = time.process_time_ns()
                found = search(case.grey, case.family)
                spent = (time.process_time_ns() - began) / 1e6 * TYPICAL_PIXELS / case.grey.size
                if found is None:
                    continue
                score = scores[name].setdefault(case.row, Score())
                if turn == 0:
                    count(found, case, score)
                    score.times_ms.append([])
                    if name == OURS and case.row == REFERENCE:
                        count(refined(found, case), case, scores.setdefault(REFINED, {}).setdefault(case.row, Score()))
                score.times_ms[-1].append(spent)
    return scores


def refined(found: Found, case: Case) -> Found:
    """The same markers with the corners that label refines."""
    return [
        (
            marker,
            np.array(
                refine(case.grey, DetectedMarker(id=marker, corners=as_quad(quad), kind="edges"), case.family).corners
            ),
        )
        for marker, quad in found
    ]


def count(found: Found, case: Case, score: Score) -> None:
    """Compare what was found with what is there; each is used once."""
    left = list(found)
    ids = {true.id for true in case.markers}
    score.pictures += 1
    for true in case.markers:
        score.markers += 1
        for index, (marker, corners) in enumerate(left):
            if marker == true.id and _near(corners, true):
                left.pop(index)
                score.found += 1
                if true.corners is not None and case.rendered:
                    score.errors_px.append(float(np.linalg.norm(corners - true.corners, axis=1).mean()))
                break
    score.unlisted += sum(marker in ids for marker, _ in left)
    score.wrong += sum(marker not in ids for marker, _ in left)


def _near(corners: Corners, true: TrueMarker) -> bool:
    return true.centre is None or float(np.linalg.norm(corners.mean(axis=0) - true.centre)) < SAME_PLACE_PX
