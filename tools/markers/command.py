"""`tagmill markers NAME`: what can be printed."""

from __future__ import annotations

import argparse
from types import ModuleType

from common.errors import EXIT_USAGE
from tools.markers import board, sheet

PRINTS: dict[str, ModuleType] = {"sheet": sheet, "board": board}
"""Each a module with ``add_parser(parser)`` and ``run(args) -> int``; its docstring is its help."""


def add_parser(parser: argparse.ArgumentParser) -> None:
    """One sub-command a kind of print."""
    names = parser.add_subparsers(dest="print", metavar="NAME")
    for name, module in PRINTS.items():
        summary = (module.__doc__ or "").strip().splitlines()[0]
        own = names.add_parser(name, help=summary, description=module.__doc__)
        own.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="print one JSON document")
        module.add_parser(own)
    parser.set_defaults(markers_parser=parser)


def run(args: argparse.Namespace) -> int:
    """Print what was named."""
    if args.print is None:
        args.markers_parser.print_help()
        return EXIT_USAGE
    code: int = PRINTS[args.print].run(args)
    return code
