"""`tagmill evaluate NAME`: the table of evaluations."""

from __future__ import annotations

import argparse

from tools.sub_commands import add_names
from tools.sub_commands import run_name as run

__all__ = ["EVALUATIONS", "add_parser", "run"]

EVALUATIONS = {
    "detect": "tools.evaluate.detect",
    "distance": "tools.evaluate.distance",
    "inpaint": "tools.evaluate.inpaint",
    "pose": "tools.evaluate.pose",
}


def add_parser(parser: argparse.ArgumentParser) -> None:
    """One sub-command an evaluation."""
    add_names(parser, EVALUATIONS)
