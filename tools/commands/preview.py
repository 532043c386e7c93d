"""`tagmill preview`: renew the lease of a camera's inpainted preview, so that any subscriber can watch it."""

from __future__ import annotations

import argparse
import threading

from common import clock
from tools.commands.client import ask, connected, finish

RENEW_EVERY_S = 2.0


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which camera, for how long."""
    parser.add_argument("camera", help="the camera's name")
    parser.add_argument("--seconds", type=float, help="end after so long (default: at Ctrl-C)")


def run(args: argparse.Namespace) -> int:
    """Renew every 2 s."""
    end_ns = None if args.seconds is None else clock.monotonic_ns() + int(args.seconds * 1e9)
    pause = threading.Event()
    with connected(args) as client:
        while True:
            answer = ask(client, {"command": "preview", "camera": args.camera})
            if not answer["ok"] or (end_ns is not None and clock.monotonic_ns() >= end_ns):
                return finish(args, answer)
            try:
                pause.wait(RENEW_EVERY_S)
            except KeyboardInterrupt:
                return finish(args, answer)
