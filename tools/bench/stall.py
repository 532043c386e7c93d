"""`tagmill bench stall`: does a camera notice that the store stands still and that each label is slow?

First nothing is recorded, as the reference. Then all cameras are recorded and ordered from while the store is stopped
(SIGSTOP); then it goes on, everything is settled, and the account is looked at.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import yaml

from common.bus import CommandClient, Endpoints
from common.config import load_rig
from common.dataset import SessionReader
from common.errors import EXIT_FOUND, EXIT_OK, EXIT_USAGE, TagmillError
from tools.bench.record_orders import RecordOrders
from tools.bench.settled import settled
from tools.bench.stall_account import account
from tools.bench.stall_table import Stalled, print_stall
from tools.bench.stall_watch import Watch
from tools.stack.running import running_stack, wait_ready

SESSION = "stall"
_WARM_UP_S = 4.0
_READY_S = 180.0
_ORDER_S = 5.0
_PATIENCE_S = 60.0
_OBJECTS = Path(__file__).resolve().parents[1] / "demo" / "rig.yaml"


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The benchmark's own arguments."""
    parser.add_argument("--cameras", type=int, default=2, help="how many, of 1280x720 with depth (2)")
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--size", default="1280x720", help="WxH")
    parser.add_argument("--seconds", type=float, default=30.0, help="of the reference, while nothing is recorded (30)")
    parser.add_argument("--stopped", type=float, default=60.0, metavar="S", help="how long the service is stopped (60)")
    parser.add_argument(
        "--stop", choices=("store", "detect.0", "label.0"), default="store", help="which service is stopped (store)"
    )
    parser.add_argument("--label-delay-ms", type=float, default=500.0, help="makes labelling a frame so much slower")
    parser.add_argument("--every-s", type=float, default=1.0, help="a sample of each camera so often; 0: each frame")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="leave the dataset and the logs there")
    parser.add_argument("--seed", type=int, default=1)


def run(args: argparse.Namespace) -> int:
    """Measure and print; exit code 5 if a frame was dropped at a camera, or something isn't accounted for."""
    size = re.fullmatch(r"(\d+)x(\d+)", args.size)
    positive = min(args.cameras, args.fps, args.seconds, args.stopped) > 0 <= min(args.label_delay_ms, args.every_s)
    if size is None or not positive or (args.keep is not None and args.keep.exists()):
        print("bench stall: --size is WxH, times and numbers are above 0, and the folder of --keep must not exist")
        return EXIT_USAGE
    with tempfile.TemporaryDirectory(prefix="tagmill-stall-") as name:
        folder = Path(name)
        os.environ["TAGMILL_RUN_DIR"] = name
        os.environ["TAGMILL_PREFIX"] = f"stall-{os.getpid()}"
        rig, log = write_rig(folder, args, (int(size[1]), int(size[2]))), folder / "stack.log"
        try:
            with running_stack(rig, log, {"TAGMILL_LABEL_DELAY_MS": str(args.label_delay_ms)}):
                stalled = measure(rig, args)
        except TagmillError:
            print(log.read_text()[-4000:])
            raise
        finally:
            if args.keep is not None:
                shutil.copytree(folder, args.keep, ignore=_sockets)
    print(json.dumps({**asdict(stalled), "found": stalled.found})) if args.json else print_stall(stalled)
    return EXIT_FOUND if stalled.found else EXIT_OK


def _sockets(folder: str, names: list[str]) -> list[str]:
    """What can't be copied."""
    return [name for name in names if (Path(folder) / name).is_socket()]


def write_rig(folder: Path, args: argparse.Namespace, size: tuple[int, int]) -> Path:
    """The demo's objects, of which any frame can be recorded, and cameras that cost next to nothing.

    Rings of two seconds: a frame that waits for two slow labels before it is taken must still be there.
    """
    rig = yaml.safe_load(_OBJECTS.read_text())
    rig["dataset"] = {"root": "./dataset", "session": SESSION}
    rig |= {"network": {"console": None}, "pose": {"ambiguous": "keep"}, "record": {"incomplete": "keep"}}
    rig["ring"] = {"slots": max(round(2 * args.fps), 12)}
    camera = {"driver": "synthetic", "width": size[0], "height": size[1], "fps": args.fps, "prerendered": 8}
    rig["cameras"] = {f"cam{number}": {**camera, "seed": args.seed + number} for number in range(args.cameras)}
    path = folder / "stall.yaml"
    path.write_text(yaml.safe_dump(rig))
    return path


def measure(rig: Path, args: argparse.Namespace) -> Stalled:
    """All phases, and the account. Raises TagmillError if the stack doesn't come up, record or settle."""
    config = load_rig(rig)
    endpoints = Endpoints.of(config.config.network)
    names = [f"cam{number}" for number in range(args.cameras)]
    with CommandClient(endpoints, timeout_s=_PATIENCE_S) as client:
        status = wait_ready(client, names, _READY_S)
        pids = {name: int(service["pid"]) for name, service in status["services"].items()}
        with Watch(endpoints, pids, args.fps) as watch:
            watch.warm_up(min(_WARM_UP_S, args.seconds))
            phases = {"nothing recorded": watch.phase(args.seconds)}
            recording = _start(client, args.every_s)
            with RecordOrders(endpoints, (*names, "all"), timeout_s=_ORDER_S, silence_s=_PATIENCE_S) as orders:
                with _stopped(pids[args.stop]):
                    phases[f"{args.stop} stopped"] = watch.phase(args.stopped)
                phases["going on"] = watch.phase(args.seconds / 3)
            stalled = Stalled(phases, watch.captured())
        stalled.ledgers = settled(client, recording, _PATIENCE_S)["cameras"]
        stalled.orders, stalled.acknowledged = dict(orders.outcomes), len(orders.acknowledged)
        again = client.request({"command": "record", "camera": "all", "timeout_s": _PATIENCE_S}, 2 * _PATIENCE_S)
        stalled.on_disk, stalled.complaints = account(
            SessionReader(config.dataset_root / SESSION),
            stalled.ledgers,
            promised=orders.acknowledged | set(again["samples"]),
            pending=orders.pending | set(again.get("pending", ())),
            patience_s=_PATIENCE_S,
        )
        stalled.complaints += [f"{count} orders had no answer ({code})" for code, count in orders.silences.items()]
        if not again["ok"]:
            stalled.complaints.append(f"in the end it doesn't record: {again['error']['message']}")
        now = wait_ready(client, names, _READY_S)["services"]
        stalled.complaints += [f"{name} was restarted" for name, pid in pids.items() if now[name]["pid"] != pid]
    return stalled


def _start(client: CommandClient, every_s: float) -> str:
    started = client.request({"command": "start", "camera": "all", "every_s": every_s})
    if not started["ok"]:
        raise TagmillError(f"the recording didn't start: {started['error']['message']}")
    return str(started["recording"])


@contextmanager
def _stopped(pid: int) -> Iterator[None]:
    """SIGSTOP, and SIGCONT after the block."""
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)
