"""The figures of `bench detect`, for people and for machines."""

from __future__ import annotations

import statistics
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from tools.bench.detect_cases import REFERENCE
from tools.bench.detect_rivals import OURS, TARGET

if TYPE_CHECKING:
    from tools.bench.detect import Score, Scores
    from tools.bench.detect_tracking import Tracked

FILE_WIDTH = 220
"""Columns of a table that goes into a file."""


def show(scores: Scores, tracked: list[Tracked], absent: list[str], missing: list[str]) -> None:
    """Four tables: what is found, what it costs, one against the other, tracking."""
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console = Console(highlight=False, markup=False, width=FILE_WIDTH)
    console.print(_recall(scores))
    console.print(_price(scores))
    console.print(_trade_off(scores))
    console.print(_tracking(tracked))
    for what, names in (("not installed", absent), ("not there", missing)):
        if names:
            console.print(f"{what}: {', '.join(names)}")


def as_plain(scores: Scores, tracked: list[Tracked], absent: list[str], missing: list[str]) -> dict[str, Any]:
    """Everything, JSON-able."""
    return {
        "cv2": cv2.__version__,
        "not_installed": absent,
        "missing": missing,
        "detectors": {name: {row: _plain(score) for row, score in rows.items()} for name, rows in scores.items()},
        "trade_off": trade_off(scores),
        "ratios_to_apriltag_2": {name: _ratios(scores, name) for name in scores},
        "tracking": [
            {"name": t.name, "frames": t.frames, "searches": t.searches, "other_ids": t.other_ids, "ratio": t.ratio}
            | {"apart_px": _mean(t.apart_px), "search_ms": _mean(t.search_ms), "track_ms": _mean(t.track_ms)}
            for t in tracked
        ],
    }


def _recall(scores: Scores) -> Table:
    table = Table(
        title=f"Found of those known, mean corner error px (cv2 {cv2.__version__}); +n unlisted, !n wrong ids"
    )
    table.add_column("row")
    for name in scores:
        table.add_column(name, justify="right")
    for row in scores[OURS]:
        table.add_row(row, *(_cell(rows.get(row)) for rows in scores.values()))
    return table


def _cell(score: Score | None) -> str:
    if score is None:
        return "-"
    text = f"{score.found}/{score.markers}" if score.markers else f"0 in {score.pictures}"
    text += f" +{score.unlisted}" if score.unlisted else ""
    text += f" !{score.wrong}" if score.wrong else ""
    return text + (f" {_mean(score.errors_px):.3f}" if score.errors_px else "")


def _price(scores: Scores) -> Table:
    table = Table(title="CPU ms for 1280x720: median (p95); beside it the ratio to AprilTag 3 decimate 2 (p5-p95)")
    table.add_column("detector")
    rows = [row for row, score in scores[OURS].items() if row == REFERENCE or (score.markers and not score.errors_px)]
    for row in rows:
        table.add_column(row, justify="right")
    for name, by_row in scores.items():
        cells = [_time(by_row.get(row), scores.get(TARGET, {}).get(row)) for row in rows]
        if any(cells):
            table.add_row(name, *cells)
    return table


def _time(score: Score | None, target: Score | None) -> str:
    if score is None or not score.times_ms:
        return ""
    times = [value for picture in score.times_ms for value in picture]
    text = f"{statistics.median(times):.1f} ({np.percentile(times, 95):.1f})"
    if target is not None and len(target.times_ms) == len(score.times_ms):
        low, middle, high = np.percentile(_pairs(score, target), [5, 50, 95])
        text += f" {middle:.2f} ({low:.2f}-{high:.2f})"
    return text


def _pairs(score: Score, target: Score) -> list[float]:
    """Ratios of times that were measured one after the other on one picture."""
    return [
        mine / its
        for ours, theirs in zip(score.times_ms, target.times_ms, strict=True)
        for mine, its in zip(ours, theirs, strict=True)
    ]


def _ratios(scores: Scores, name: str) -> dict[str, float]:
    targets = scores.get(TARGET, {})
    return {
        row: statistics.median(_pairs(score, targets[row]))
        for row, score in scores[name].items()
        if score.times_ms and row in targets and len(targets[row].times_ms) == len(score.times_ms)
    }


def trade_off(scores: Scores) -> list[dict[str, Any]]:
    """Each detector as a point: its share of the markers of three sorts of pictures, and its price on them.

    Only rows that the default has are counted. A price is the median ratio to `TARGET`; None where that is absent.
    """
    kinds = {
        REFERENCE: [REFERENCE],
        "difficult": [row for row, score in scores[OURS].items() if score.errors_px and row != REFERENCE],
        "photographs": [row for row, score in scores[OURS].items() if score.markers and not score.errors_px],
    }
    points = []
    for name, rows in scores.items():
        if not all(row in rows for row in kinds["difficult"]):
            continue
        point: dict[str, Any] = {"detector": name, "default": name == OURS}
        ratios = _ratios(scores, name)
        for kind, wanted in kinds.items():
            # Photographs of families that the yardstick doesn't know can't be compared.
            seen = [row for row in wanted if row in rows and (kind == "difficult" or row in scores.get(TARGET, rows))]
            markers = sum(rows[row].markers for row in seen)
            point[kind] = sum(rows[row].found for row in seen) / markers if markers else None
        priced = [row for row in (*kinds[REFERENCE], *kinds["photographs"]) if row in ratios]
        points.append(point | {"ratios": {row: ratios[row] for row in priced}})
    return points


def _trade_off(scores: Scores) -> Table:
    table = Table(title="Trade-off: markers found, and time as a share of AprilTag 3 decimate 2's; * is the default")
    points = trade_off(scores)
    table.add_column("detector")
    for heading in (REFERENCE, "difficult", "photographs"):
        table.add_column(f"found, {heading}", justify="right")
    rows = list(dict.fromkeys(row for point in points for row in point["ratios"]))
    for row in rows:
        table.add_column(f"time, {row}", justify="right")
    for point in points:
        shares = (
            "-" if point[k] is None else f"{100 * point[k]:.1f} %" for k in (REFERENCE, "difficult", "photographs")
        )
        prices = (f"{point['ratios'][row]:.2f}" if row in point["ratios"] else "-" for row in rows)
        table.add_row(point["detector"] + (" *" if point["default"] else ""), *shares, *prices)
    return table


def _tracking(tracked: list[Tracked]) -> Table:
    table = Table(title="Tracking against a full search of each frame")
    for heading in ("sequence", "frames", "searched whole", "frames of other ids", "corners apart px"):
        table.add_column(heading, justify="right")
    for heading in ("search ms", "track ms", "ratio of sums", "ratio of medians"):
        table.add_column(heading, justify="right")
    for t in tracked:
        medians = statistics.median(t.track_ms) / statistics.median(t.search_ms)
        figures = [f"{_mean(t.apart_px):.3f}", f"{_mean(t.search_ms):.2f}", f"{_mean(t.track_ms):.2f}"]
        counts = [str(t.frames), str(t.searches), str(t.other_ids)]
        table.add_row(t.name, *counts, *figures, f"{t.ratio:.2f}", f"{medians:.2f}")
    return table


def _plain(score: Score) -> dict[str, Any]:
    times = [value for picture in score.times_ms for value in picture]
    counts = {name: getattr(score, name) for name in ("pictures", "markers", "found", "unlisted", "wrong")}
    if not times:
        return {**counts, "corner_error_px": _mean(score.errors_px)}
    spread = {"median_ms": statistics.median(times), "p95_ms": float(np.percentile(times, 95))}
    return {**counts, "corner_error_px": _mean(score.errors_px), **spread}


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None
