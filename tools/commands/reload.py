"""`tagmill reload`: check the changed rig file and let the running stack take it over."""

from __future__ import annotations

import argparse
from pathlib import Path

from tools.commands.client import ask, connected, finish
from tools.stack.programs import CONFIG_FILE

RELOAD_S = 40.0


def add_parser(_: argparse.ArgumentParser) -> None:
    """Nothing of its own: the stack knows its rig file."""


def run(args: argparse.Namespace) -> int:
    """Print what changed; exit code 78 with all mistakes if the file can't be used."""
    with connected(args) as client:
        answer = ask(client, {"command": "reload"}, RELOAD_S)
        supervisorctl = _supervisorctl(client.run_dir)
    if answer["ok"] and not args.json:
        changed = ", ".join(answer["changed"])
        print(f"taken over: {changed}" if changed else "nothing has changed")
        for service in answer["restart"]:
            program = service.replace(".", "-", 1)
            print(f"{service} takes its change over when it is restarted: {supervisorctl} restart {program}")
        for warning in answer["warnings"]:
            print(f"warning: {warning}")
    return finish(args, answer)


def _supervisorctl(run_dir: Path | None) -> str:
    """What reaches the supervisor of `tagmill up`; one that was started by hand has its file elsewhere."""
    config = None if run_dir is None else run_dir / CONFIG_FILE
    return f"supervisorctl -c {config}" if config is not None and config.is_file() else "supervisorctl"
