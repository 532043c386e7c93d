"""`tagmill evaluate NAME`: the table of evaluations."""

from __future__ import annotations

import argparse
from types import ModuleType

from common.errors import EXIT_USAGE
from tools.evaluate import distance, inpaint, pose

EVALUATIONS: dict[str, ModuleType] = {
    "distance": distance,
    "inpaint": inpaint,
    "pose": pose,
}
"""Each a module with ``add_parser(parser)`` and ``run(args) -> int``; its docstring is its help."""


def add_parser(parser: argparse.ArgumentParser) -> None:
    """One sub-command an evaluation."""
    names = parser.add_subparsers(dest="evaluation", metavar="NAME")
    for name, module in EVALUATIONS.items():
        summary = (module.__doc__ or "").strip().splitlines()[0]
        own = names.add_parser(name, help=summary, description=module.__doc__)
        own.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="print one JSON document")
        module.add_parser(own)
    parser.set_defaults(evaluation_parser=parser)


def run(args: argparse.Namespace) -> int:
    """Run the named evaluation."""
    if args.evaluation is None:
        args.evaluation_parser.print_help()
        return EXIT_USAGE
    code: int = EVALUATIONS[args.evaluation].run(args)
    return code
