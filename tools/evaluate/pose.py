"""`tagmill evaluate pose`: how exact projected boxes and windows are, by rendering the paper's Table 1.

Two picture sizes and three sizes of marker: the same seeded poses of a box with a marker on each lateral side are
labelled and compared with the truth. Beside it stands how the paper judged the eight corners by eye (- bad,
o acceptable, + good).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress

from common.errors import EXIT_OK
from common.geometry import Box, BoxSide, MarkerOnSide
from common.labels import FaceName
from common.markers import family
from tools.evaluate.chain import Chain, Studio, camera_of
from tools.report.compare import Difference, compare
from tools.report.files import write_json
from tools.report.page import Page
from tools.report.plot import Axis, Series, plot
from tools.report.table import print_table

CAMERAS = ((640, 480, 614.4), (1280, 720, 921.6))
"""Width, height, focal length in px: of one camera, which has the same vertical field of view in both."""
MARKERS_MM = (15.0, 25.0, 50.0)
PAPER = {  # width, marker: the paper's Table 1
    (640, 15): "-",
    (640, 25): "-",
    (640, 50): "o",
    (1280, 15): "-",
    (1280, 25): "o",
    (1280, 50): "+",
}
SIZE_MM = (400.0, 300.0, 300.0)
STEP = 37
"""Frames of the scene's path from one evaluated pose to the next."""
_COLUMNS = ("picture, marker", "found", "px", "p95", "IoU", "ambig.", "px sure", "IoU sure", "paper")
_SET_UP = (
    "Rendered box of 400 x 300 x 300 mm at 0.8 to 1.2 m with one marker on each lateral side, so one or two are seen; "
    "lens blur 0.6 px, noise sigma 3. Corners: distance of each of the box's eight projected corners from the truth. "
    "IoU: of the unclipped detection window. px, p95 and IoU count the poses that one small marker leaves ambiguous, "
    "too; 'sure' are the others: what `pose.ambiguous: refuse`, the default, records."
)


@dataclass(frozen=True)
class Exactness:
    """One row. Corner errors in px, windows as intersection over union; NaN where there is nothing to measure.

    ``ambiguous`` is how many of the labelled have a second pose that fits as well; ``sure_...`` are without them.
    """

    width: int
    height: int
    marker_mm: float
    frames: int
    labelled: int
    ambiguous: int
    corner_mean_px: float
    corner_p95_px: float
    iou_mean: float
    iou_p5: float
    sure_corner_mean_px: float
    sure_iou_mean: float

    @property
    def name(self) -> str:
        """As the paper's table names it."""
        return f"{self.width}x{self.height} {self.marker_mm:g} mm"

    @property
    def paper(self) -> str:
        """The paper's mark."""
        return PAPER[self.width, round(self.marker_mm)]

    def plain(self) -> dict[str, Any]:
        """For JSON: NaN becomes null."""
        return {key: None if value != value else value for key, value in vars(self).items()} | {"paper": self.paper}

    def cells(self) -> list[str]:
        """For a table."""
        all_ = (_shown(self.corner_mean_px, 2), _shown(self.corner_p95_px, 2), _shown(self.iou_mean, 4))
        sure = (_shown(self.sure_corner_mean_px, 2), _shown(self.sure_iou_mean, 4))
        return [self.name, f"{self.labelled}/{self.frames}", *all_, str(self.ambiguous), *sure, self.paper]


def _shown(value: float, digits: int) -> str:
    return "-" if value != value else f"{value:.{digits}f}"


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The evaluation's own arguments."""
    parser.add_argument("--seed", type=int, default=1, help="of poses and noise (1)")
    parser.add_argument("--frames", type=int, default=40, help="poses for each row (40)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write pose.html and pose.json there")


def run(args: argparse.Namespace) -> int:
    """Evaluate and print."""
    frames = max(args.frames, 1)
    with Progress(console=Console(stderr=True), transient=True, disable=args.json) as progress:
        task = progress.add_task("rendering and measuring", total=frames * len(CAMERAS) * len(MARKERS_MM))
        rows = list(table_1(args.seed, frames, lambda: progress.advance(task)))
    document = {"evaluation": "pose", "seed": args.seed, "frames": frames, "rows": [row.plain() for row in rows]}
    if args.out is not None:
        _report(rows, args.seed).write(args.out / "pose.html")
        write_json(document, args.out / "pose.json")
    if args.json:
        print(json.dumps(document))
        return EXIT_OK
    console = Console(highlight=False)
    print_table(
        console, "Projected box against the truth (right: the paper's Table 1)", _COLUMNS, [r.cells() for r in rows]
    )
    console.print(_SET_UP, style="dim")
    if args.out is not None:
        console.print(f"Report: {args.out / 'pose.html'}", soft_wrap=True)
    return EXIT_OK


def table_1(seed: int, frames: int, done: Callable[[], object]) -> Iterator[Exactness]:
    """All rows; ``done`` is called after each frame."""
    for width, height, focal_px in CAMERAS:
        for marker_mm in MARKERS_MM:
            yield _row(width, height, focal_px, marker_mm, seed, frames, done)


def _row(
    width: int, height: int, focal_px: float, marker_mm: float, seed: int, frames: int, done: Callable[[], object]
) -> Exactness:
    markers, camera, box = family("apriltag_36h11", Path()), camera_of(width, height, focal_px), _box(marker_mm)
    studio, chain = Studio((box,), markers, camera, seed), Chain((box,), markers, camera)
    found: list[tuple[Difference, bool]] = []
    for number in range(frames):
        shot = studio.shot(number * STEP)
        labels = chain.label(shot.noisy(np.random.default_rng([seed, number])))
        ambiguous = {label.name for label in labels if label.quality.ambiguous}
        found += [(one, one.object in ambiguous) for one in compare(labels, shot.rendered.truth)]
        done()
    every = [one for one, _ in found]
    sure = [one for one, ambiguous in found if not ambiguous]
    corners = [px for one in every for px in one.corners_px]
    windows = [one.iou for one in every]
    return Exactness(
        width,
        height,
        marker_mm,
        frames,
        len(every),
        len(every) - len(sure),
        _mean(corners),
        _percentile(corners, 95),
        _mean(windows),
        _percentile(windows, 5),
        _mean([px for one in sure for px in one.corners_px]),
        _mean([one.iou for one in sure]),
    )


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _percentile(values: Sequence[float], percent: float) -> float:
    return float(np.percentile(values, percent)) if values else float("nan")


def _box(marker_mm: float) -> Box:
    faces: tuple[FaceName, ...] = ("front", "back", "left", "right")
    sides = (BoxSide(face, face, (MarkerOnSide(id_, marker_mm, marker_mm / 5),)) for id_, face in enumerate(faces))
    return Box("box", "box", SIZE_MM, tuple(sides))


def _report(rows: Sequence[Exactness], seed: int) -> Page:
    page = Page("How exact projected boxes are")
    page.text(f"{_SET_UP} {rows[0].frames} poses a row, seed {seed}.")
    page.table(_COLUMNS, [row.cells() for row in rows])
    sizes = Axis("marker, mm", {mm: f"{mm:g}" for mm in MARKERS_MM})
    by_camera = [(f"{w}x{h}", [row for row in rows if row.width == w]) for w, h, _ in CAMERAS]
    corner, window = Axis("error of a corner, px", log=True), Axis("IoU of the window")
    mean = [Series(f"{name}: mean, to p95", MARKERS_MM, *_span(of_it)) for name, of_it in by_camera]
    overlap = [
        Series(
            f"{name}: mean, to p5",
            MARKERS_MM,
            [r.iou_mean for r in of_it],
            [r.iou_p5 for r in of_it],
            [r.iou_mean for r in of_it],
        )
        for name, of_it in by_camera
    ]
    if any(row.labelled for row in rows):
        page.figure(plot("Eight projected corners", sizes, corner, mean))
        page.figure(plot("Detection window", sizes, window, overlap))
    page.note(
        "Paper: S. Cybinski, Semi-automated image data labelling using AprilTags, Informatics Inside 2019, Table 1."
    )
    return page


def _span(rows: Sequence[Exactness]) -> tuple[list[float], list[float], list[float]]:
    means = [row.corner_mean_px for row in rows]
    return means, means, [row.corner_p95_px for row in rows]
