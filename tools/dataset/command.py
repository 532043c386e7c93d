"""`tagmill dataset NAME`: the table of what can be done to stored samples."""

from __future__ import annotations

import argparse

from tools.sub_commands import add_names
from tools.sub_commands import run_name as run

__all__ = ["ACTIONS", "add_parser", "run"]

ACTIONS = {
    "list": "tools.dataset.list_samples",
    "delete": "tools.dataset.delete",
    "restore": "tools.dataset.restore",
    "empty-bin": "tools.dataset.empty_bin",
    "merge": "tools.dataset.merge",
    "split": "tools.dataset.split",
    "rename-class": "tools.dataset.rename_class",
}


def add_parser(parser: argparse.ArgumentParser) -> None:
    """One sub-command an action."""
    add_names(parser, ACTIONS)
