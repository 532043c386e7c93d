"""All markers of a rig as a print-ready PDF at true scale, with a ruler that shows whether the printer kept to it."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from common.boards.outlines import outlines
from common.config import load_rig
from common.errors import EXIT_OK, RefusedError
from tools.check import MUCH, chosen_rig
from tools.markers import measured
from tools.markers.files import pdf_path, png, svg, write_bytes
from tools.markers.label import RigMarker, rig_markers
from tools.markers.pages import draw, lay_out
from tools.markers.paper import Paper, parse_paper

_PX_PER_MM = 24.0
"""Of single markers as PNG, about 600 dpi; each cell gets whole pixels."""


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The sub-command's own arguments."""
    parser.add_argument("file", nargs="?", type=Path, help="the rig file (instead of --rig)")
    parser.add_argument("--paper", type=parse_paper, default="A4", help="A4 (default), Letter, A3, ... or 210x297 (mm)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="the PDF (default: markers-<rig>-<paper>.pdf)")
    parser.add_argument("--png", type=Path, metavar="DIR", help="write each marker as PNG there, too")
    parser.add_argument("--svg", type=Path, metavar="DIR", help="write each marker as SVG there, too")
    parser.add_argument(
        "--measured",
        type=measured.parse_measured,
        metavar="MM",
        help="what the printed 100 mm ruler measures: prints the real sizes for the rig file instead of a sheet",
    )


def run(args: argparse.Namespace) -> int:
    """Write the sheet, or say what a measured ruler means."""
    path = chosen_rig(args.file or args.rig)
    markers = rig_markers(load_rig(path, cameras=False))
    if not markers:
        raise RefusedError(f"{path}: no object has a marker, so there is nothing to print", code="nothing_to_print")
    if args.measured is not None:
        if args.json:
            print(json.dumps(measured.document(markers, args.measured)))
        else:
            print("\n".join(measured.words(markers, args.measured, path.name)))
        return EXIT_OK
    paper: Paper = args.paper.upright
    sheet = lay_out(markers, paper)
    out: Path = pdf_path(args.out, f"markers-{path.stem}-{paper.name}.pdf")
    write_bytes(out, draw(sheet, path))
    singles = list(_write_singles(markers, args.png, args.svg))
    warnings = list(_warnings(markers))
    if args.json:
        print(json.dumps(_document(out, paper, sheet.pages, singles, markers, warnings)))
        return EXIT_OK
    pages = "1 page" if sheet.pages == 1 else f"{sheet.pages} pages"
    count = "1 marker" if len(markers) == 1 else f"{len(markers)} markers"
    print(f"{out}: {count} on {pages} of {paper.name}")
    for one in markers:
        share = f"takes {one.share.part:.1%} of its side"
        print(f"  {one.object}, {one.side.class_name}: marker {one.marker.id}, {one.marker.size_mm:g} mm, {share}")
    if singles:
        print(f"{len(singles)} files with single markers in {', '.join(sorted({str(p.parent) for p in singles}))}")
    print("".join(f"warning: {text}\n" for text in warnings), end="")
    print("Print at 100 %, measure the ruler, then: tagmill markers sheet", path, "--measured WHAT-IT-MEASURES")
    return EXIT_OK


def _write_singles(markers: Sequence[RigMarker], pngs: Path | None, svgs: Path | None) -> Iterator[Path]:
    for one in markers:
        cells = outlines(one.family.bitmap(one.marker.id) == 0)
        loops = [loop * one.cell_mm + one.marker.border_mm for loop in cells]
        size = (one.edge_mm, one.edge_mm)
        if pngs is not None:
            px_per_mm = max(1, round(one.cell_mm * _PX_PER_MM)) / one.cell_mm
            border_px = round(one.marker.border_mm * px_per_mm)
            even = [loop * one.cell_mm + border_px / px_per_mm for loop in cells]
            edge = one.marker.size_mm + 2 * border_px / px_per_mm
            path = pngs / f"{one.name}.png"
            write_bytes(path, png(even, (edge, edge), px_per_mm))
            yield path
        if svgs is not None:
            path = svgs / f"{one.name}.svg"
            write_bytes(
                path, svg(loops, size, f"{one.object} {one.side.class_name}: {one.family.name} {one.marker.id}")
            )
            yield path


def _warnings(markers: Sequence[RigMarker]) -> Iterator[str]:
    for one in markers:
        if one.share.part > MUCH:
            yield one.share.warning
        if one.marker.border_mm < one.cell_mm - 0.05:
            yield (
                f"object {one.object}, side {one.side.class_name}: marker {one.marker.id} has a border of "
                f"{one.marker.border_mm:g} mm; on a dark side it is only found with a white border of at least one of "
                f"its cells: border_mm: {one.cell_mm:.3g}"
            )


def _document(
    out: Path, paper: Paper, pages: int, singles: list[Path], markers: Sequence[RigMarker], warnings: list[str]
) -> dict[str, Any]:
    return {
        "ok": True,
        "file": str(out),
        "paper": paper.name,
        "pages": pages,
        "singles": [str(path) for path in singles],
        "markers": [
            {"object": one.object, "side": one.side.class_name, "marker": one.marker.id}
            | {"marker_size_mm": one.marker.size_mm, "border_mm": one.marker.border_mm}
            | {"covers": round(one.share.part, 4)}
            for one in markers
        ],
        "warnings": warnings,
    }
