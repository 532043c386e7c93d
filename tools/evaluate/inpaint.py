"""`tagmill evaluate inpaint`: how like erased regions are to the truth, what that costs, and what is left of markers.

The synthetic camera renders each frame with and without markers; the frame is labelled and erased as for a sample.
One marker of some frames is covered by a hand or blurred, some objects reach out of the picture.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress

from common.errors import EXIT_OK, DatasetError
from common.geometry import Pose
from common.scene import Scene, SceneCamera
from services.detect.markers import open_detector
from services.label.inpaint import METHODS, erase
from services.label.labelling import Labeller
from services.label.masks import Crop, mask_of
from services.label.regions import regions_on_sides
from services.label.surfaces import Region
from tools.bench.detect_rivals import Search, contenders
from tools.evaluate.chain import KEEP, UPRIGHT
from tools.evaluate.erased_scenes import CAMERA, FAMILY, Case, boxes, cases
from tools.evaluate.likeness import Likeness, likenesses, psnr
from tools.report.files import write_json
from tools.report.sheet import Row, contact_sheet
from tools.report.table import print_table

Picture = NDArray[np.uint8]
Mask = NDArray[np.bool_]

SEARCHERS = ("tagmill auto", "cv2 defaults", "AprilTag 3 decimate 1", "locus grid")
TIMED_PX = 80.0
ROUNDS = 30
SHOWN_ROWS = 12
SHOWN_PX = 3000
"""Regions below this are too small to be looked at."""
_COLUMNS = ("method", "PSNR dB", "median", "p5", "SSIM", "grain", "ms", "p95", "to telea", "found")
_EXPLAINED = (
    "PSNR of all erased pixels, median and 5th percentile of the regions; SSIM; grain: fine structure as a share of "
    "the truth's (1 = as grainy); ms an 80 px marker on one core (median, 95th percentile, rounds interleaved); found: "
    "markers that detectors still find after erasing."
)
_WHOLE = Crop(0, 0, CAMERA.width, CAMERA.height)


@dataclass
class Result:
    """One method: its regions' likeness, its times (ms an 80 px marker), what each detector still found."""

    method: str
    regions: list[Likeness] = field(default_factory=list)
    times_ms: list[float] = field(default_factory=list)
    found: Counter[str] = field(default_factory=Counter)

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        each = [region.psnr for region in self.regions]
        pixels = sum(region.pixels for region in self.regions)

        def mean(of: Callable[[Likeness], float]) -> float:
            return sum(of(region) * region.pixels for region in self.regions) / max(pixels, 1)

        return {
            "method": self.method,
            "regions": len(each),
            "psnr_db": psnr(mean(lambda region: region.squared_error)),
            "psnr_median_db": float(np.median(each)),
            "psnr_p5_db": float(np.percentile(each, 5)),
            "ssim": mean(lambda region: region.ssim),
            "grain": float(np.median([region.grain for region in self.regions])),
            "ms_median": statistics.median(self.times_ms),
            "ms_p95": float(np.percentile(self.times_ms, 95)),
            "found": dict(self.found),
        }


@dataclass
class Outcome:
    """All methods, and what is the same for all of them."""

    results: dict[str, Result]
    absent: list[str]
    frames: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    undetected: int = 0
    marker_pixels: int = 0
    marker_pixels_left: int = 0
    frames_with_marker_left: list[int] = field(default_factory=list)
    found_before: Counter[str] = field(default_factory=Counter)
    shown: list[tuple[float, Row]] = field(default_factory=list)

    def document(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "frames": dict(self.frames),
            "refused": self.refused,
            "visible_markers_undetected": self.undetected,
            "marker_pixels": self.marker_pixels,
            "marker_pixels_outside_mask": self.marker_pixels_left,
            "frames_with_marker_pixels_left": self.frames_with_marker_left,
            "found_before": dict(self.found_before),
            "not_installed": self.absent,
            "methods": [result.plain() for result in self.results.values()],
        }


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The evaluation's own arguments."""
    parser.add_argument("--seed", type=int, default=1, help="of scenes and noise (1)")
    parser.add_argument("--frames", type=int, default=36, help="frames to erase (36)")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="write inpaint.png (a contact sheet) and inpaint.json there"
    )


def run(args: argparse.Namespace) -> int:
    """Evaluate and print."""
    cv2.setNumThreads(1)
    frames = max(args.frames, 1)
    with Progress(console=Console(stderr=True), transient=True, disable=args.json) as progress:
        task = progress.add_task("rendering and erasing", total=frames)
        outcome = evaluate(args.seed, frames, lambda: progress.advance(task))
    document = {"evaluation": "inpaint", "seed": args.seed} | outcome.document()
    if args.out is not None:
        write_json(document, args.out / "inpaint.json")
        _write_sheet(outcome, args.out / "inpaint.png")
    if args.json:
        print(json.dumps(document))
    else:
        _show(outcome, document, args.out)
    return EXIT_OK


def evaluate(seed: int, frames: int, done: Callable[[], object] = lambda: None, rounds: int = ROUNDS) -> Outcome:
    """Erase seeded frames by every method; ``done`` is called after each frame."""
    searches, absent = contenders()
    searches = {name: searches[name] for name in SEARCHERS if name in searches}
    outcome = Outcome({method: Result(method) for method in METHODS}, absent)
    _time(outcome.results, seed, rounds)
    for case in cases(seed, frames):
        outcome.frames[case.kind] += 1
        if case.missed:
            outcome.refused += 1
        else:
            _judge(case, outcome, searches)
        done()
    return outcome


def _judge(case: Case, outcome: Outcome, searches: dict[str, Search]) -> None:
    mask = mask_of([region.polygon for region in case.regions], _WHOLE) > 0
    if case.covered is not None:
        mask &= ~case.covered.keep
    outcome.marker_pixels += int(case.marker.sum())
    left = int((case.marker & ~mask).sum())
    outcome.marker_pixels_left += left
    if left:
        outcome.frames_with_marker_left.append(outcome.frames.total())
    outcome.undetected += max(case.unseen, 0)
    outcome.found_before.update(_found(case.bgr, searches))
    count, numbers = cv2.connectedComponents(mask.view(np.uint8))
    regions = [np.asarray(numbers == number) for number in range(1, count)]
    pictures = {}
    for method, result in outcome.results.items():
        pictures[method] = case.bgr.copy()
        erase(pictures[method], case.regions, method, covered=case.covered)
        result.regions += likenesses(pictures[method], case.bare, regions)
        result.found.update(_found(pictures[method], searches))
    for region, likeness in zip(regions, outcome.results[METHODS[0]].regions[-len(regions) :], strict=False):
        if region.sum() >= SHOWN_PX:
            views = (case.bgr, *(pictures[method] for method in reversed(METHODS)), case.bare)
            outcome.shown.append((likeness.psnr, _row(views, region, f"{case.kind}, {likeness.psnr:.1f} dB")))


def _found(bgr: Picture, searches: dict[str, Search]) -> dict[str, int]:
    grey = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    return {name: len(search(grey, FAMILY) or ()) for name, search in searches.items()}


def _time(results: dict[str, Result], seed: int, rounds: int) -> None:
    """Each method in turn on one marker of 80 px, on this thread's clock: other processes don't count."""
    bgr, region = _timed_marker(seed)
    for _ in range(rounds):
        for method, result in results.items():
            picture = bgr.copy()
            began = time.thread_time()
            erase(picture, [region], method)
            result.times_ms.append((time.thread_time() - began) * 1e3)


def _timed_marker(seed: int) -> tuple[Picture, Region]:
    box = boxes()[0]
    side, marker = box.markers()[0]
    distance = float(CAMERA.matrix[0, 0]) * marker.size_mm / TIMED_PX
    turn = Pose.from_rvec([0.0, np.radians(15.0), 0.0], np.zeros(3)).rotation @ UPRIGHT
    on_box = box.marker_pose(side, marker).translation
    pose = Pose(turn, np.array([0.0, 0.0, distance]) - turn @ on_box)
    scene = SceneCamera(Scene([box], FAMILY, seed), CAMERA)
    bgr = scene.render(0, {box.name: pose}).bgr
    grey = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    labelled = Labeller([box], FAMILY, KEEP).label_once(open_detector(FAMILY, Path()).detect(grey), CAMERA, bgr)
    found = regions_on_sides(labelled.objects, labelled.left_out, [box], CAMERA)
    return bgr, next(region for region in found if region.polygon.marker == marker.id)


def _row(views: Iterable[Picture], region: Mask, caption: str) -> Row:
    left, top, width, height = cv2.boundingRect(region.view(np.uint8))
    half = round(0.5 * max(width, height) + 26)
    x = int(np.clip(left + width // 2, half, CAMERA.width - half))
    y = int(np.clip(top + height // 2, half, CAMERA.height - half))
    return Row(tuple(view[y - half : y + half, x - half : x + half].copy() for view in views), caption)


def _write_sheet(outcome: Outcome, path: Path) -> None:
    """The worst, middling and best regions of the default method."""
    if not outcome.shown:
        return
    ordered = [row for _, row in sorted(outcome.shown, key=lambda item: item[0])]
    chosen = sorted({round(at) for at in np.linspace(0, len(ordered) - 1, min(SHOWN_ROWS, len(ordered)))})
    columns = ("before", *reversed(METHODS), "truth")
    title = f"Erased by each method, worst first by {METHODS[0]}"
    sheet = contact_sheet(title, columns, [ordered[index] for index in chosen], across=1, width=230)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), sheet):
        message = f"the contact sheet {path} can't be written"
        raise DatasetError(message)


def _show(outcome: Outcome, document: dict[str, Any], out: Path | None) -> None:
    console = Console(highlight=False)
    telea = statistics.median(outcome.results["telea"].times_ms)
    rows = []
    for row in document["methods"]:
        quality = (f"{row['psnr_db']:.1f}", f"{row['psnr_median_db']:.1f}", f"{row['psnr_p5_db']:.1f}")
        look = (f"{row['ssim']:.3f}", f"{row['grain']:.2f}")
        cost = (f"{row['ms_median']:.1f}", f"{row['ms_p95']:.1f}", f"{row['ms_median'] / telea:.2f}")
        rows.append([row["method"], *quality, *look, *cost, str(sum(row["found"].values()))])
    print_table(console, "Erased regions against the same pictures without markers", _COLUMNS, rows)
    console.print(_EXPLAINED, style="dim")
    kinds = ", ".join(f"{count} {kind}" for kind, count in outcome.frames.items())
    console.print(
        f"Frames: {kinds}; left out, because an object in view has no sure pose (refused by default): {outcome.refused}"
    )
    console.print(f"Visible markers that were not detected: {outcome.undetected}")
    left, all_ = outcome.marker_pixels_left, outcome.marker_pixels
    where = ", ".join(str(number) for number in outcome.frames_with_marker_left)
    console.print(f"Marker pixels outside the erase mask: {left} of {all_}" + (f" (in frame {where})" if where else ""))
    before = ", ".join(f"{name} {count}" for name, count in outcome.found_before.items())
    console.print(f"Markers found before erasing: {before}")
    if outcome.absent:
        console.print("Not installed, so not asked: " + ", ".join(outcome.absent))
    if out is not None:
        console.print(f"Contact sheet: {out / 'inpaint.png'}", soft_wrap=True)
