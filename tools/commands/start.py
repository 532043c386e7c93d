"""`tagmill start`: begin a recording; with `--wait` stay until it has ended, and print its ledger."""

from __future__ import annotations

import argparse
import sys
import threading
from typing import Any

from rich.console import Console
from rich.live import Live

from common import clock
from common.bus import CommandClient
from common.errors import EXIT_OK, NoAnswerError, TagmillError
from tools.commands.client import ask, connected, finish
from tools.commands.show import ledger_view, progress_line

LOOK_EVERY_S = 0.5
START_S = 15.0
GIVE_UP_S = 30.0
_LIMITS = {
    "new_deg": "a view is new by so many degrees",
    "new_mm": "or by so many mm of distance",
    "sharpness": "at least this sharp (100: an edge within a pixel, 10: within ten)",
    "fit_px": "a reprojection error of at most this",
}
OVER = ("ended", "interrupted")


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The fields of the command `start`, and `--wait`."""
    parser.add_argument("--camera", default="all", help="a camera's name, or 'all' (the default)")
    parser.add_argument("--every", type=float, default=0.0, metavar="S", help="a sample every S seconds; 0: each frame")
    parser.add_argument("--until-count", type=int, metavar="N", help="end by itself after N samples of each camera")
    parser.add_argument("--mode", choices=("all", "auto"), default="all", help="auto takes only new views")
    for name, words in _LIMITS.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, metavar="X", help=f"auto: {words}")
    parser.add_argument("--background", action="store_true", help="pictures without an object")
    parser.add_argument("--wait", action="store_true", help="stay until the recording has ended")


def run(args: argparse.Namespace) -> int:
    """Print the recording's id; with ``--wait`` its ledger at the end."""
    request = {
        "command": "start",
        "camera": args.camera,
        "every_s": args.every,
        "until_count": args.until_count,
        "mode": args.mode,
        "background": args.background,
        **{name: getattr(args, name) for name in _LIMITS},
    }
    with connected(args) as client:
        answer = ask(client, request, START_S)
        if not answer["ok"]:
            return finish(args, answer)
        for camera in answer["missing"]:
            print(f"{camera} is not there and is left out; see 'tagmill status'", file=sys.stderr)
        if not args.wait:
            if not args.json:
                print(answer["recording"])
            return finish(args, answer)
        ledger = _wait(client, answer["recording"], quiet=args.json)
    if not args.json:
        Console().print(ledger_view(ledger))
    return finish(args, {"ok": True, "recording": answer["recording"], "ledger": ledger}) if args.json else EXIT_OK


def _wait(client: CommandClient, recording: str, *, quiet: bool) -> dict[str, Any]:
    """Look twice a second until the recording is over; Ctrl-C ends the waiting, not the recording.

    A stack that is being restarted is waited for. Raises NoAnswerError if it stays away, TagmillError if nobody
    knows the recording any more.
    """
    pause = threading.Event()
    last_answer_ns = clock.monotonic_ns()
    try:
        with Live(console=Console(stderr=True, quiet=quiet), transient=True, refresh_per_second=4) as live:
            while True:
                try:
                    answer = ask(client, {"command": "ledger", "recording": recording})
                    last_answer_ns = clock.monotonic_ns()
                except NoAnswerError:
                    if clock.monotonic_ns() - last_answer_ns > GIVE_UP_S * 1e9:
                        raise
                    continue
                if answer["ok"]:
                    ledger: dict[str, Any] = answer["ledger"]
                    live.update(progress_line(ledger))
                    if ledger["phase"] in OVER:
                        return ledger
                elif answer["error"]["code"] == "no_recording":
                    raise TagmillError(answer["error"]["message"], code="no_recording")
                pause.wait(LOOK_EVERY_S)
    except KeyboardInterrupt:
        print(f"{recording} goes on; 'tagmill stop' ends it", file=sys.stderr)
        raise
