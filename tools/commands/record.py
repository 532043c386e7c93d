"""`tagmill record`: samples now; waits until they are durable."""

from __future__ import annotations

import argparse
import sys

from tools.commands.client import AFTER_S, ask, connected, finish


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The fields of the command `record`."""
    parser.add_argument("--camera", default="all", help="a camera's name, or 'all' (the default)")
    parser.add_argument("--count", type=int, default=1, help="how many samples, for each camera")
    parser.add_argument("--interval", type=float, default=0.0, metavar="S", help="seconds between two samples")
    parser.add_argument("--timeout", type=float, default=5.0, metavar="S", help="how long to wait for fitting frames")
    parser.add_argument("--frame", type=int, help="only this frame, if it is still in the ring")
    parser.add_argument("--background", action="store_true", help="pictures without an object")


def run(args: argparse.Namespace) -> int:
    """Print the names of the durable samples, one a line."""
    request = {
        "command": "record",
        "camera": args.camera,
        "count": args.count,
        "interval_s": args.interval,
        "timeout_s": args.timeout,
        "frame": args.frame,
        "background": args.background,
    }
    with connected(args) as client:
        answer = ask(client, request, max(args.timeout, 0.0) + AFTER_S)
    if not args.json:
        for sample in answer.get("samples", ()):
            print(sample)
        for sample in answer.get("pending", ()):
            print(f"{sample} is not durable yet", file=sys.stderr)
    return finish(args, answer)
