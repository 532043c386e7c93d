"""`tagmill bench load`: synthetic cameras drive the real stack; where frames go, how late, at what cost.

The producers render a short path ahead and repeat it, so that they cost next to nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import yaml

from common.bus import CommandClient, Endpoints, Subscriber
from common.config import load_rig
from common.errors import EXIT_OK, EXIT_USAGE, TagmillError
from common.topics import CAMERA, DETECTIONS, FRAME, LABELS, SERVICE
from tools.bench.load_counter import CameraLoad, LoadCounter
from tools.bench.load_hops import Hop
from tools.bench.load_table import print_growth, print_load
from tools.bench.processes import Usage, usage_between, usage_now
from tools.bench.record_orders import RecordOrders
from tools.stack.running import running_stack, wait_ready

_WARM_UP_S = 4.0
_STALL_S = 20.0
_STOP_S = 60.0
_OBJECTS = Path(__file__).resolve().parents[1] / "demo" / "rig.yaml"


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The benchmark's own arguments."""
    parser.add_argument(
        "--cameras", default="4", help="how many; 1,2,4,8: one measurement each, and where it saturates"
    )
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--size", default="1280x720", help="WxH")
    parser.add_argument("--seconds", type=float, default=30.0, help="measured, after a warm-up of 4 s")
    parser.add_argument("--label-delay-ms", type=float, default=0.0, help="make labelling this much slower a frame")
    parser.add_argument(
        "--stall-store", action="store_true", help="stop the store process for 20 s (or 2/3 of the time) and record"
    )
    parser.add_argument(
        "--record", type=int, default=0, metavar="N", help="record every frame of the first N cameras meanwhile"
    )
    parser.add_argument("--workers", type=int, default=1, help="detect and label processes that share the cameras")
    parser.add_argument("--detect-workers", type=int, help="another number of detect processes")
    parser.add_argument("--label-workers", type=int, help="another number of label processes")
    parser.add_argument("--seed", type=int, default=1)


@dataclass
class Load:
    """The whole measurement."""

    seconds: float
    cameras: dict[str, CameraLoad]
    processes: dict[str, Usage]
    records: dict[str, int]
    hops: dict[str, Hop]


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    size = re.fullmatch(r"(\d+)x(\d+)", args.size)
    counts = [int(count) for count in args.cameras.split(",")] if re.fullmatch(r"\d+(,\d+)*", args.cameras) else [0]
    if size is None or min(counts) < 1 or args.seconds <= 0 or args.workers < 1:
        print("bench load: --size is WxH, --cameras like 4 or 1,2,4,8, --seconds above 0, --workers at least 1")
        return EXIT_USAGE
    loads = {count: _load(count, (int(size[1]), int(size[2])), args) for count in counts}
    if args.json:
        plain = {str(count): asdict(load) for count, load in loads.items()}
        print(json.dumps(plain if len(counts) > 1 else asdict(loads[counts[0]])))
        return EXIT_OK
    for count, load in loads.items():
        print_load(load, {**vars(args), "cameras": count})
    if len(counts) > 1:
        print_growth(loads)
    return EXIT_OK


def _load(cameras: int, size: tuple[int, int], args: argparse.Namespace) -> Load:
    """One measurement with a stack of its own."""
    with tempfile.TemporaryDirectory(prefix="tagmill-load-") as folder:
        os.environ["TAGMILL_RUN_DIR"] = folder
        os.environ["TAGMILL_PREFIX"] = f"load-{os.getpid()}"
        rig = write_rig(Path(folder), args, cameras, size)
        environment = {"TAGMILL_LABEL_DELAY_MS": str(args.label_delay_ms)}
        log = Path(folder) / "stack.log"
        try:
            with running_stack(rig, log, environment):
                return measure(rig, cameras, args)
        except TagmillError:
            print(log.read_text()[-4000:])
            raise


def write_rig(folder: Path, args: argparse.Namespace, cameras: int, size: tuple[int, int]) -> Path:
    """The demo's objects, and as many synthetic cameras as asked for."""
    rig = yaml.safe_load(_OBJECTS.read_text())
    rig["dataset"] = {"root": "./dataset", "session": "load"}
    rig["network"] = {"console": None}
    rig["workers"] = {"detect": args.detect_workers or args.workers, "label": args.label_workers or args.workers}
    rig["cameras"] = {
        f"cam{index}": {
            "driver": "synthetic",
            "width": size[0],
            "height": size[1],
            "fps": args.fps,
            "seed": args.seed + index,
            "prerendered": 16,
        }
        for index in range(cameras)
    }
    path = folder / "load.yaml"
    path.write_text(yaml.safe_dump(rig))
    return path


def measure(rig: Path, cameras: int, args: argparse.Namespace) -> Load:
    """Warm up, count for the given time, and say what each process cost."""
    endpoints = Endpoints.of(load_rig(rig).config.network)
    names = [f"cam{index}" for index in range(cameras)]
    subscriber = Subscriber(endpoints)
    client = CommandClient(endpoints, timeout_s=5.0)
    try:
        status = wait_ready(client, names)
        for topic in (FRAME, CAMERA, DETECTIONS, LABELS, SERVICE):
            subscriber.subscribe(topic)
        pids = {name: int(service["pid"]) for name, service in status["services"].items()}
        counter = LoadCounter(subscriber, args.fps)
        counter.listen(_WARM_UP_S)
        counter.reset()
        before = usage_now(pids)
        recording = _start(client, names[: args.record])
        stall_s = min(_STALL_S, args.seconds * 2 / 3) if args.stall_store else 0.0
        with RecordOrders(endpoints, names if args.stall_store else []) as records, _stalled(pids["store"], stall_s):
            counter.listen(args.seconds)
        usage = usage_between(before, usage_now(pids))
        outcomes = records.outcomes + Counter(_stop(client, recording))
        return Load(counter.seconds, counter.result(), usage, dict(outcomes), counter.hops())
    finally:
        client.close()
        subscriber.close()


def _start(client: CommandClient, cameras: list[str]) -> list[str]:
    """Begin a recording of every frame on each camera; their ids. Raises TagmillError if one is refused."""
    begun = [client.request({"command": "start", "camera": name, "every_s": 0}) for name in cameras]
    for answer in begun:
        if not answer["ok"]:
            raise TagmillError(f"the recording didn't start: {answer['error']['message']}")
    return [answer["recording"] for answer in begun]


def _stop(client: CommandClient, recordings: list[str]) -> dict[str, int]:
    """End them; frames by what became of them."""
    counts: Counter[str] = Counter()
    for recording in recordings:
        answer = client.request({"command": "stop", "recording": recording}, timeout_s=_STOP_S)
        for account in (account for ledger in answer["ledgers"] for account in ledger["cameras"].values()):
            counts["frames recorded"] += account["recorded"]
            counts.update({f"frames refused: {why}": count for why, count in account["refused"].items()})
            counts.update({f"frames dropped at {where}": count for where, count in account["dropped"].items()})
    return dict(counts)


@contextmanager
def _stalled(pid: int, seconds: float) -> Iterator[None]:
    """Stop a process for the first ``seconds`` of the block, and let it go on at the latest at the block's end."""
    if seconds <= 0:
        yield
        return
    timer = threading.Timer(seconds, os.kill, (pid, signal.SIGCONT))
    os.kill(pid, signal.SIGSTOP)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        os.kill(pid, signal.SIGCONT)
