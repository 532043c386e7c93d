"""`tagmill bench console`: what it costs that somebody looks.

One synthetic camera through the real stack: first nobody looks, then one page does, then eight. A page is a client of
the console's WebSocket. The first one decodes each picture and reads the number burnt into it, so that the latency is
that of these very pixels: from the frame's capture to its being decoded at the other end; the others acknowledge.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import yaml
from rich.console import Console

from common.bus import CommandClient, Endpoints, Poller, Subscriber
from common.clock import monotonic_ns
from common.config import load_rig
from common.errors import EXIT_OK, EXIT_USAGE, TagmillError
from common.messages import FrameAnnounced, FrameRef
from common.topics import FRAME
from tools.bench.console_pages import Pages
from tools.bench.processes import Usage, usage_between, usage_now
from tools.report.table import print_table
from tools.stack.running import running_stack, wait_ready

_OBJECTS = Path(__file__).resolve().parents[1] / "demo" / "rig.yaml"
_WARM_UP_S = 4.0
_FRAME_S = 10.0
CAMERA = "cam0"


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The benchmark's own arguments."""
    parser.add_argument("--viewers", default="0,1,8", help="how many pages look, one measurement each (0,1,8)")
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--size", default="1280x720", help="WxH")
    parser.add_argument("--seconds", type=float, default=20.0, help="each, after a warm-up of 4 s")


@dataclass(frozen=True)
class Looking:
    """One measurement; pictures are each page's, latencies the first page's (ms)."""

    viewers: int
    captured_per_s: float
    pictures_per_s: float
    slowest_page_per_s: float
    glass_to_glass_p50_ms: float | None
    glass_to_glass_p99_ms: float | None
    wrong_pixels: int
    processes: dict[str, Usage]


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    size = re.fullmatch(r"(\d+)x(\d+)", args.size)
    viewers = re.fullmatch(r"\d+(,\d+)*", args.viewers)
    if size is None or viewers is None or args.seconds <= 0 or args.fps <= 0:
        print("bench console: --size is WxH, --viewers like 0,1,8, --seconds and --fps above 0")
        return EXIT_USAGE
    with tempfile.TemporaryDirectory(prefix="tagmill-console-") as folder:
        os.environ["TAGMILL_RUN_DIR"] = folder
        os.environ["TAGMILL_PREFIX"] = f"console-{os.getpid()}"
        rig = _write_rig(Path(folder), args.fps, (int(size[1]), int(size[2])))
        log = Path(folder) / "stack.log"
        try:
            with running_stack(rig, log):
                rows = measure(rig, [int(count) for count in args.viewers.split(",")], int(size[1]), args.seconds)
        except TagmillError:
            print(log.read_text()[-4000:])
            raise
    print(json.dumps([asdict(row) for row in rows])) if args.json else _print(rows, args)
    return EXIT_OK


def _write_rig(folder: Path, fps: float, size: tuple[int, int]) -> Path:
    rig = yaml.safe_load(_OBJECTS.read_text())
    rig["dataset"] = {"root": "./dataset", "session": "console"}
    camera = {"driver": "synthetic", "width": size[0], "height": size[1], "fps": fps, "prerendered": 16}
    rig["cameras"] = {CAMERA: camera | {"burn_frame": True}}
    path = folder / "console.yaml"
    path.write_text(yaml.safe_dump(rig))
    return path


def measure(rig: Path, viewers: list[int], width: int, seconds: float) -> list[Looking]:
    """One row for each number of viewers."""
    endpoints = Endpoints.of(load_rig(rig).config.network)
    with CommandClient(endpoints) as client:
        status = wait_ready(client, [CAMERA])
        url = _url(client)
        pids = {name: int(service["pid"]) for name, service in status["services"].items()}
        pids |= {"console": int(client.request({"command": "status"})["services"]["console"]["pid"])}
        subscriber = Subscriber(endpoints)
        subscriber.subscribe(FRAME, CAMERA)
        try:
            return [_look(url, count, width, seconds, subscriber, pids) for count in viewers]
        finally:
            subscriber.close()


def _url(client: CommandClient) -> str:
    """Where the console is, as soon as it says so; raises TagmillError after 30 s."""
    pause, deadline = Poller(), monotonic_ns() + 30_000_000_000
    while monotonic_ns() < deadline:
        service = client.request({"command": "status"})["services"].get("console")
        if service is not None and service["texts"].get("url"):
            return str(service["texts"]["url"])
        pause.wait(0.2)
    raise TagmillError("the console has not come up; is the extra installed (pip install 'tagmill[console]')?")


def _look(url: str, count: int, width: int, seconds: float, subscriber: Subscriber, pids: dict[str, int]) -> Looking:
    with Pages(url, CAMERA, count, width) as pages:
        _wait(subscriber, _WARM_UP_S)
        pages.reset()
        before, first = usage_now(pids), _wait(subscriber, 0.0)
        _wait(subscriber, seconds)
        last = _wait(subscriber, 0.0)
        usage = usage_between(before, usage_now(pids))
        result = pages.result()
    elapsed_s = (last.captured_mono_ns - first.captured_mono_ns) / 1e9
    return Looking(
        viewers=count,
        captured_per_s=round((last.count - first.count) / elapsed_s, 2),
        pictures_per_s=round(sum(result.pictures) / max(count, 1) / elapsed_s, 1),
        slowest_page_per_s=round(min(result.pictures, default=0) / elapsed_s, 1),
        glass_to_glass_p50_ms=result.p50_ms,
        glass_to_glass_p99_ms=result.p99_ms,
        wrong_pixels=result.wrong_pixels,
        processes=usage,
    )


def _wait(subscriber: Subscriber, seconds: float) -> FrameRef:
    """Listen for so long, then for one more frame, which is returned; raises TagmillError if none comes."""
    poller, until = Poller(subscriber), monotonic_ns() + int(seconds * 1e9)
    while monotonic_ns() < until + int(_FRAME_S * 1e9):
        poller.wait(0.5)
        for received in subscriber.receive():
            if isinstance(received.message, FrameAnnounced) and monotonic_ns() >= until:
                return received.message.ref
    raise TagmillError(f"{CAMERA} gave no frame for {_FRAME_S:g} s")


def _print(rows: list[Looking], args: argparse.Namespace) -> None:
    def row(one: Looking) -> list[str]:
        others = sum(usage.cpu_percent for name, usage in one.processes.items() if name != "console")
        late = "-" if one.glass_to_glass_p50_ms is None else f"{one.glass_to_glass_p50_ms:.1f}"
        latest = "-" if one.glass_to_glass_p99_ms is None else f"{one.glass_to_glass_p99_ms:.1f}"
        console = one.processes.get("console")
        own, memory = ("-", "-") if console is None else (f"{console.cpu_percent:.1f}", f"{console.memory_mb:.0f}")
        mean, slowest = (f"{one.pictures_per_s:.1f}", f"{one.slowest_page_per_s:.1f}") if one.viewers else ("-", "-")
        rate = f"{one.captured_per_s:.2f}"
        return [str(one.viewers), rate, mean, slowest, late, latest, own, memory, f"{others:.1f}"]

    print_table(
        Console(highlight=False),
        f"Console, {args.size} at {args.fps:g}/s, {args.seconds:g} s each\n"
        "ms: capture to decoded at the page; CPU: % of a core, of the console and of the others",
        ("pages", "captured/s", "shown/s", "slowest", "p50 ms", "p99 ms", "CPU", "MB", "others"),
        [row(one) for one in rows],
    )
    wrong = sum(one.wrong_pixels for one in rows)
    if wrong:
        print(f"{wrong} pictures showed another frame than their header said")
