"""`tagmill cameras NAME`: the table of what there is to ask about cameras."""

from __future__ import annotations

import argparse

from tools.sub_commands import add_names
from tools.sub_commands import run_name as run

__all__ = ["add_parser", "run"]

NAMES = {
    "list": "tools.cameras.listing",
    "test": "tools.cameras.trial",
}


def add_parser(parser: argparse.ArgumentParser) -> None:
    """One sub-command a question."""
    add_names(parser, NAMES)
