"""A sub-command that is itself a table of names: `tagmill bench NAME`, `tagmill evaluate NAME` and their like.

A name's module has ``add_parser(parser)`` and ``run(args) -> int``; its docstring's first line is its help. Modules
are imported when the sub-command is called, since the help shows their docstrings.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Mapping
from types import ModuleType

from common.errors import EXIT_USAGE

_NAME, _MODULES, _PARSER = "table_name", "table_modules", "table_parser"


def add_names(parser: argparse.ArgumentParser, modules: Mapping[str, str]) -> None:
    """One sub-command a name; ``modules``: the dotted module behind each."""
    names = parser.add_subparsers(dest=_NAME, metavar="NAME")
    loaded: dict[str, ModuleType] = {}
    for name, where in modules.items():
        loaded[name] = module = importlib.import_module(where)
        summary = (module.__doc__ or "").strip().splitlines()[0]
        own = names.add_parser(name, help=summary, description=module.__doc__)
        own.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="print one JSON document")
        module.add_parser(own)
    parser.set_defaults(**{_MODULES: loaded, _PARSER: parser})


def run_name(args: argparse.Namespace) -> int:
    """Run the name that was typed; without one, show the names and give the exit code of wrong usage."""
    name = getattr(args, _NAME)
    if name is None:
        getattr(args, _PARSER).print_help()
        return EXIT_USAGE
    code: int = getattr(args, _MODULES)[name].run(args)
    return code
