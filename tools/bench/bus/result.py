"""The figures of `bench bus`: by way and readers, and what one more reader costs."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np
from rich.console import Console

from tools.report.table import print_table

RIVAL = "ZeroMQ ipc"


@dataclass(frozen=True)
class Case:
    """What was measured."""

    way: str
    readers: int
    round: int


@dataclass(frozen=True)
class Result:
    """CPU (user + system, all processes) in ms a frame, latencies of all readers in ms, frames that a reader missed."""

    case: Case
    cpu_ms: float
    late_ms: list[float]
    lost: int


def summed_up(results: Sequence[Result]) -> dict[str, Any]:
    """What one more reader costs: CPU ms a frame by way, and as a ratio to raw ZeroMQ ipc of the same round."""
    ways = list(dict.fromkeys(one.case.way for one in results))
    rounds = sorted({one.case.round for one in results})
    slopes = {way: [_slope([one for one in results if _is(one, way, round_)]) for round_ in rounds] for way in ways}
    ratios = {
        way: [mine / rival for mine, rival in zip(slopes[way], slopes[RIVAL], strict=True)]
        for way in ways
        if way != RIVAL and all(slopes[RIVAL])
    }
    return {"one_more_reader_ms": slopes, "ratio_to_zmq_ipc": ratios}


def _is(result: Result, way: str, round_: int) -> bool:
    return result.case.way == way and result.case.round == round_


def _slope(results: Sequence[Result]) -> float:
    """Least squares over the number of readers; 0 where there is only one number."""
    readers = [one.case.readers for one in results]
    if len(set(readers)) < 2:
        return 0.0
    return float(np.polyfit(readers, [one.cpu_ms for one in results], 1)[0])


def print_results(results: Sequence[Result], document: dict[str, Any], args: argparse.Namespace) -> None:
    """Two tables."""
    console = Console(highlight=False)
    rows = []
    for way in dict.fromkeys(one.case.way for one in results):
        for readers in sorted({one.case.readers for one in results}):
            own = [one for one in results if one.case.way == way and one.case.readers == readers]
            late = [ms for one in own for ms in one.late_ms] or [float("nan")]
            cpu = [one.cpu_ms for one in own]
            rows.append(
                [
                    way,
                    str(readers),
                    *(f"{value:.2f}" for value in (np.percentile(late, 50), np.percentile(late, 99), max(late))),
                    f"{median(cpu):.2f} ({min(cpu):.2f}-{max(cpu):.2f})",
                    str(sum(one.lost for one in own)),
                ]
            )
    print_table(
        console,
        f"1280x720 RGB-D (4.6 MB) at {args.fps:g}/s, {args.frames} frames, {args.rounds} rounds\n"
        "ms: capture to the grey picture; CPU: ms a frame, all processes, median (range of the rounds)",
        ("way", "readers", "p50 ms", "p99 ms", "max ms", "CPU ms", "missed"),
        rows,
    )
    ratios = document["ratio_to_zmq_ipc"]
    print_table(
        console,
        "One more reader: CPU ms a frame, and its ratio to raw ZeroMQ ipc in the same round",
        ("way", "ms", "ratio"),
        [
            [way, _spread(slopes), _spread(ratios.get(way, []))]
            for way, slopes in document["one_more_reader_ms"].items()
        ],
    )


def _spread(values: Sequence[float]) -> str:
    return f"{median(values):.2f} ({min(values):.2f}-{max(values):.2f})" if values else "1"
