"""Move samples to their session's bin; `restore` puts them back, `empty-bin` removes them for good."""

from __future__ import annotations

import argparse

from tools.dataset.moving import add_samples as add_parser
from tools.dataset.moving import move

__all__ = ["add_parser", "run"]


def run(args: argparse.Namespace) -> int:
    """All of them, or none."""
    return move(args, "delete", "in the bin")
