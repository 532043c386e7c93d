"""`tagmill bench NAME`: the table of benchmarks."""

from __future__ import annotations

import argparse

from tools.stack.running import interrupt_by_sigterm
from tools.sub_commands import add_names, run_name

__all__ = ["BENCHES", "add_parser", "run"]

BENCHES = {
    "load": "tools.bench.load",
    "detect": "tools.bench.detect",
    "render": "tools.bench.render",
    "console": "tools.bench.console",
    "record": "tools.bench.record",
    "stall": "tools.bench.stall",
    "chaos": "tools.bench.chaos.command",
    "bus": "tools.bench.bus.command",
    "torn": "tools.bench.torn",
    "soak": "tools.bench.soak",
}


def add_parser(parser: argparse.ArgumentParser) -> None:
    """One sub-command a benchmark."""
    add_names(parser, BENCHES)


def run(args: argparse.Namespace) -> int:
    """Run the benchmark that was typed."""
    interrupt_by_sigterm()
    return run_name(args)
