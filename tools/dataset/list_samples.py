"""List a session's samples, the newest first, or those in its bin (--bin)."""

from __future__ import annotations

import argparse

from pydantic import ValidationError
from rich.console import Console
from rich.table import Table

from common.errors import RefusedError
from common.messages import MOST_LISTED, SampleFilter
from tools.commands.client import finish
from tools.dataset.place import InFolder, OverSocket, Plain, add_place, chosen

_OPTIONS: dict[str, tuple[str, type]] = {
    "object": ("with this object (its name in the rig)", str),
    "type": ("with an object of this type", str),
    "side": ("with this side seen", str),
    "camera": ("of this camera", str),
    "recording": ("of this recording", str),
    "min_distance_mm": ("with an object at least so far away", float),
    "max_distance_mm": ("with an object at most so far away", float),
    "max_reprojection_px": ("with a reprojection error up to this", float),
    "max_uncertainty_mm": ("with a distance known this well (one sigma)", float),
}
_CHOICES = {
    "ambiguous": "with an ambiguous pose (--no-ambiguous: without)",
    "complete": "in which every object has a pose",
    "background": "recorded on purpose without an object",
}


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which session, which samples, how many."""
    add_place(parser)
    for name, (words, kind) in _OPTIONS.items():
        parser.add_argument(_option(name), dest=name, type=kind, help=words)
    for name, words in _CHOICES.items():
        parser.add_argument(_option(name), action=argparse.BooleanOptionalAction, help=words)
    parser.add_argument("--bin", action="store_true", help="those in the bin")
    parser.add_argument("--offset", type=int, default=0, help="pass over so many (default 0)")
    parser.add_argument("--limit", type=int, default=50, help="at most so many (default 50)")
    parser.add_argument("--names", action="store_true", help="only the names, one a line, e.g. for 'delete -'")


def run(args: argparse.Namespace) -> int:
    """Print a table and how many there are."""
    wanted = _filter_of(args)
    with chosen(args) as place:
        answer = _pages(place, wanted, args.offset, args.limit)
    if answer["ok"] and not args.json:
        if args.names:
            print("".join(f"{sample['name']}\n" for sample in answer["samples"]), end="")
        else:
            _show(answer, wanted)
    return finish(args, answer)


def _filter_of(args: argparse.Namespace) -> SampleFilter:
    if args.offset < 0 or args.limit < 0:
        raise RefusedError("--offset and --limit must be 0 or more", code="out_of_bounds")
    given = {name: getattr(args, name) for name in (*_OPTIONS, *_CHOICES)}
    try:
        return SampleFilter(bin=args.bin, **given)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise RefusedError(f"{_option(str(first['loc'][0]))}: {first['msg']}", code="out_of_bounds") from error


def _pages(place: InFolder | OverSocket, wanted: SampleFilter, offset: int, limit: int) -> Plain:
    """As many requests as the number that was asked for needs."""
    answer = place.page(wanted, offset, min(limit, MOST_LISTED))
    whole = answer
    while answer["ok"] and answer["next_offset"] is not None and len(whole["samples"]) < limit:
        answer = place.page(wanted, answer["next_offset"], min(limit - len(whole["samples"]), MOST_LISTED))
        if not answer["ok"]:
            return answer
        whole = {**answer, "samples": [*whole["samples"], *answer["samples"]]}
    return whole


def _show(answer: Plain, wanted: SampleFilter) -> None:
    table = Table(box=None, padding=(0, 2, 0, 0))
    for title in ("sample", "object", "sides", "distance", "seen from", "fit"):
        table.add_column(title, overflow="fold", no_wrap=title == "sample")
    for sample in answer["samples"]:
        rows = [_object_row(found) for found in sample["objects"]] or [("", "", "", "", "")]
        for number, row in enumerate(rows):
            table.add_row(sample["name"] if number == 0 else "", *row)
    console = Console()
    if answer["samples"]:
        console.print(table)
    shown, total = len(answer["samples"]), answer["total"]
    everything = answer["in_bin"] if wanted.bin else answer["stored"]
    where = f"the bin of {answer['session']}" if wanted.bin else answer["session"]
    rest = "" if wanted.bin else f"; {answer['in_bin']} in the bin"
    console.print(f"{shown} of {total} that match, {everything} in {where}{rest}", highlight=False)


def _object_row(found: Plain) -> tuple[str, ...]:
    sure = "" if found["uncertainty_mm"] is None else f" ±{found['uncertainty_mm']:.1f}"
    return (
        found["name"],
        ", ".join(found["sides"]),
        f"{found['distance_mm']:.0f}{sure} mm",
        f"{found['azimuth_deg']:.0f}°, {found['elevation_deg']:.0f}°",
        f"{found['reprojection_error_px']:.2f} px{' ambiguous' if found['ambiguous'] else ''}",
    )


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")
