"""Put samples back from their session's bin."""

from __future__ import annotations

import argparse

from tools.dataset.moving import add_samples as add_parser
from tools.dataset.moving import move

__all__ = ["add_parser", "run"]


def run(args: argparse.Namespace) -> int:
    """All of them, or none."""
    return move(args, "restore", "back")
