"""`tagmill evaluate distance`: how exact distances are, by rendering the paper's Table 2 or on your own pictures.

Without --folder: a 50 mm marker squarely before a camera of 1280x720 at 200 to 1000 mm, and two markers on one side.
With --folder, --truth and a rig file: pictures whose distances you measured (a CSV or YAML file: file, distance_mm).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from common.errors import EXIT_OK, ConfigError
from tools.evaluate import measured_distance
from tools.evaluate.measured_distance import Measured
from tools.evaluate.rendered_distance import FAR_MM, REAL_MM, Joint, joint, table_2
from tools.evaluate.spread import Spread
from tools.report.files import write_json
from tools.report.page import Page
from tools.report.plot import Axis, Series, plot
from tools.report.table import print_table

PAPER = {  # real mm: min, max, mean difference
    200: (197, 203, 0.0),
    300: (298, 302, 0.0),
    400: (399, 401, 0.0),
    500: (498, 501, 0.5),
    600: (597, 600, 1.5),
    700: (698, 703, 0.5),
    800: (789, 810, 0.5),
    900: (890, 908, 1.0),
    1000: (991, 1008, 0.5),
}
"""Table 2 of S. Cybinski, Informatics Inside 2019."""
MEAN_MM, RANGE_MM, JOINT_RANGE_MM = 0.3, 4.0, 1.5
"""What is to be reached at 1000 mm with markers of 50 mm."""
_COLUMNS = ("real", "found", "min", "max", "range", "mean", "sd", "diff.")
_PAPER_COLUMNS = ("paper", "diff.")
_JOINT_COLUMNS = ("distance of", *_COLUMNS[1:])
_TARGET_COLUMNS = ("what", "mm", "at most", "reached")
_SET_UP = (
    "Rendered 1280x720, f 921.6 px, 50 mm marker, lens blur 0.6 px, noise sigma 3; our detector, refinement and pose. "
    "Distances are those of the marker's own corners (the paper's equation 2); the place varies by half a pixel."
)


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The evaluation's own arguments."""
    parser.add_argument("--seed", type=int, default=1, help="of places and noise (1)")
    parser.add_argument("--frames", type=int, default=50, help="rendered frames at each distance (50)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write distance.html and distance.json there")
    parser.add_argument("--folder", type=Path, metavar="PICTURES", help="evaluate these pictures instead (with --rig)")
    parser.add_argument("--rig", type=Path, default=argparse.SUPPRESS, metavar="FILE", help="the pictures' rig file")
    parser.add_argument("--truth", type=Path, metavar="FILE", help="their distances (default: truth.csv in the folder)")
    parser.add_argument("--camera", metavar="NAME", help="the rig's camera that took them (default: its first)")


def run(args: argparse.Namespace) -> int:
    """Evaluate and print."""
    return _on_pictures(args) if args.folder is not None else _by_rendering(args)


def _by_rendering(args: argparse.Namespace) -> int:
    frames = max(args.frames, 2)
    console = Console(highlight=False)
    with Progress(console=Console(stderr=True), transient=True, disable=args.json) as progress:
        task = progress.add_task("rendering and measuring", total=frames * (len(REAL_MM) + 1))

        def done() -> None:
            progress.advance(task)

        rows = list(table_2(args.seed, frames, done))
        two = joint(args.seed, frames, done)
    targets = targets_of(rows, two)
    document = {
        "evaluation": "distance",
        "seed": args.seed,
        "frames": frames,
        "rows": [row.plain() | {"paper": PAPER.get(round(row.real))} for row in rows],
        "joint": {name: row.plain() for name, row in vars(two).items()},
        "targets": [
            {"what": what, "value": value, "limit": limit, "reached": ok} for what, value, limit, ok in targets
        ],
    }
    if args.out is not None:
        _report(rows, two, targets, frames, args.seed).write(args.out / "distance.html")
        write_json(document, args.out / "distance.json")
    if args.json:
        print(json.dumps(document))
        return EXIT_OK
    title = "A marker squarely before the camera, mm (right: the paper's Table 2)"
    print_table(console, title, (*_COLUMNS, *_PAPER_COLUMNS), _paper_rows(rows))
    print_table(console, "Two markers on a side, 20 degrees, 1000 mm", _JOINT_COLUMNS, _joint_rows(two))
    print_table(console, "To be reached at 1000 mm", _TARGET_COLUMNS, _target_rows(targets))
    console.print(_SET_UP, style="dim")
    _say_where(console, args.out)
    return EXIT_OK


def targets_of(rows: Sequence[Spread], two: Joint) -> list[tuple[str, float, float, bool]]:
    """What is to be reached, the value, its limit, whether it is: rows of the report."""
    far = next(row for row in rows if row.real == FAR_MM)
    found = (
        ("one marker, |mean difference|", abs(far.mean_difference), MEAN_MM),
        ("one marker, range", far.range, RANGE_MM),
        ("two markers joint, |mean difference|", abs(two.marker.mean_difference), MEAN_MM),
        ("two markers joint, range of a marker", two.marker.range, JOINT_RANGE_MM),
        ("two markers joint, range of the box's centre", two.object.range, JOINT_RANGE_MM),
    )
    return [(what, value, limit, bool(value <= limit)) for what, value, limit in found]


def _on_pictures(args: argparse.Namespace) -> int:
    truth = args.truth if args.truth is not None else args.folder / "truth.csv"
    if args.rig is None:
        raise ConfigError("pictures need the rig that they show and the camera's calibration: name it with --rig")
    pictures = measured_distance.measure(args.folder, truth, args.rig, args.camera)
    rows = measured_distance.by_distance(pictures)
    document = {
        "evaluation": "distance",
        "folder": str(args.folder),
        "pictures": [picture.plain() for picture in pictures],
        "rows": [row.plain() for row in rows],
    }
    if args.out is not None:
        _pictures_report(pictures, rows).write(args.out / "distance.html")
        write_json(document, args.out / "distance.json")
    if args.json:
        print(json.dumps(document))
        return EXIT_OK
    console = Console(highlight=False)
    print_table(console, "Each picture, mm", measured_distance.COLUMNS, [picture.cells() for picture in pictures])
    print_table(console, "By distance, mm", _COLUMNS, [_cells(row) for row in rows])
    _say_where(console, args.out)
    return EXIT_OK


def _cells(row: Spread, name: str | None = None) -> list[str]:
    first = [name or f"{row.real:g}", f"{row.found}/{row.frames}"]
    if not row.found:
        return [*first, *["-"] * (len(_COLUMNS) - 2)]
    values = (f"{row.min:.2f}", f"{row.max:.2f}", f"{row.range:.2f}", f"{row.mean:.2f}", f"{row.sd:.3f}")
    return [*first, *values, f"{round(row.mean_difference, 2) + 0.0:+.2f}"]


def _paper_rows(rows: Sequence[Spread]) -> list[list[str]]:
    """Ours beside the paper's."""
    return [
        [*_cells(row), f"{low}-{high}", f"{difference:g}"]
        for row in rows
        for low, high, difference in (PAPER[round(row.real)],)
    ]


def _joint_rows(two: Joint) -> list[list[str]]:
    return [
        _cells(two.own, "each marker by itself"),
        _cells(two.marker, "each marker, joint pose"),
        _cells(two.object, "box centre, joint pose"),
    ]


def _target_rows(targets: Sequence[tuple[str, float, float, bool]]) -> list[list[str]]:
    return [[what, f"{value:.2f}", f"{limit:g}", "yes" if ok else "no"] for what, value, limit, ok in targets]


def _report(
    rows: Sequence[Spread], two: Joint, targets: Sequence[tuple[str, float, float, bool]], frames: int, seed: int
) -> Page:
    page = Page("How exact distances are")
    page.text(f"{_SET_UP} {frames} frames at each distance, seed {seed}.")
    page.table((*_COLUMNS, *_PAPER_COLUMNS), _paper_rows(rows))
    page.figure(plot("Error of the distance: tagmill and the paper", _REAL, _ERROR, [_series(rows), _paper_series()]))
    page.figure(plot("The same, tagmill alone", _REAL, _ERROR, [_series(rows)]))
    page.heading("Two markers on one side")
    page.text("200 mm apart on a side of 400 x 300 mm that is tilted by 20 degrees, its middle at 1000 mm.")
    page.table(_JOINT_COLUMNS, _joint_rows(two))
    page.heading("To be reached at 1000 mm")
    page.table(_TARGET_COLUMNS, _target_rows(targets))
    page.note(
        "Paper: S. Cybinski, Semi-automated image data labelling using AprilTags, Informatics Inside 2019, Table 2."
    )
    return page


_REAL = Axis("real distance, mm")
_ERROR = Axis("estimate minus real, mm", zero=True)


def _series(rows: Sequence[Spread], name: str = "tagmill: mean, min to max") -> Series:
    return Series(
        name,
        [row.real for row in rows],
        [row.mean_difference for row in rows],
        [row.min - row.real for row in rows],
        [row.max - row.real for row in rows],
    )


def _paper_series() -> Series:
    low = [float(low - real) for real, (low, _, _) in PAPER.items()]
    high = [float(high - real) for real, (_, high, _) in PAPER.items()]
    middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    return Series("paper: middle, min to max", [float(real) for real in PAPER], middle, low, high, line=False)


def _pictures_report(pictures: Sequence[Measured], rows: Sequence[Spread]) -> Page:
    page = Page("How exact distances are, on pictures")
    page.table(_COLUMNS, [_cells(row) for row in rows])
    if any(row.found for row in rows):
        page.figure(plot("Error of the distance", _REAL, _ERROR, [_series(rows, "mean, min to max")]))
    page.heading("Each picture")
    page.table(measured_distance.COLUMNS, [picture.cells() for picture in pictures])
    return page


def _say_where(console: Console, out: Path | None) -> None:
    if out is not None:
        console.print(f"Report: {out / 'distance.html'}", soft_wrap=True)
