"""`tagmill bench NAME`: the table of benchmarks."""

from __future__ import annotations

import argparse

from common.errors import EXIT_USAGE
from tools.bench import detect, load, render

BENCHES = {"load": load, "detect": detect, "render": render}


def add_parser(parser: argparse.ArgumentParser) -> None:
    """One sub-command a benchmark."""
    names = parser.add_subparsers(dest="bench", metavar="NAME")
    for name, module in BENCHES.items():
        summary = (module.__doc__ or "").strip().splitlines()[0]
        own = names.add_parser(name, help=summary, description=module.__doc__)
        own.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="print one JSON document")
        module.add_parser(own)
    parser.set_defaults(bench_parser=parser)


def run(args: argparse.Namespace) -> int:
    """Run the named benchmark."""
    if args.bench is None:
        args.bench_parser.print_help()
        return EXIT_USAGE
    code: int = BENCHES[args.bench].run(args)
    return code
