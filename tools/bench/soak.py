"""`tagmill bench soak`: does anything grow, in memory, file descriptors, segments, over a long recording?

Two synthetic cameras, a recording of both, single records and `status` all the while. Every process is looked at again
and again; what counts is how its figures at the end compare with those after the warm-up.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import psutil
import yaml
from rich.console import Console

from common.bus import CommandClient, Endpoints, Poller
from common.clock import monotonic_ns
from common.config import load_rig
from common.errors import EXIT_FOUND, EXIT_OK, EXIT_USAGE, TagmillError
from common.frames import shm_folder
from tools.report.table import print_table
from tools.stack.running import running_stack, wait_ready

CAMERAS = ("cam0", "cam1")
SLOPE_OVER_S = 900.0
"""A shorter time says nothing of memory: caches and allocators still fill."""
FLAT_MB_PER_HOUR = 12.0
_LOOKS = 200
_WARM_UP = 0.25
_OBJECTS = Path(__file__).resolve().parents[1] / "demo" / "rig.yaml"


@dataclass
class Growth:
    """One service with its workers, at each look after the warm-up: memory (MB, unique set), descriptors, processes.

    ``mb_per_hour``: see ``slope``; None where it can't be told.
    """

    memory_mb: list[float] = field(default_factory=list)
    descriptors: list[int] = field(default_factory=list)
    processes: list[int] = field(default_factory=list)
    at_s: list[float] = field(default_factory=list)
    mb_per_hour: float | None = None

    @property
    def more_descriptors(self) -> int:
        """The least of the last quarter above the most of what came before: what never comes back."""
        last = max(len(self.descriptors) // 4, 1)
        return min(self.descriptors[-last:]) - max(self.descriptors[:-last] or self.descriptors)


@dataclass
class Soaked:
    """The whole run. ``segments``: of shared memory, at the first look and at the last."""

    seconds: float
    samples: int
    services: dict[str, Growth]
    segments: tuple[int, int]
    restarted: list[str]

    @property
    def complaints(self) -> list[str]:
        """What grew, a sentence each."""
        found = [f"{name} was restarted" for name in self.restarted]
        for name, one in self.services.items():
            if one.more_descriptors > 0:
                found.append(f"{name} has {one.more_descriptors} file descriptors more than ever before")
            if one.mb_per_hour is not None and one.mb_per_hour > FLAT_MB_PER_HOUR:
                found.append(f"the memory of {name} grows by {one.mb_per_hour:.1f} MB an hour")
        if self.segments[1] > self.segments[0]:
            found.append(f"there were {self.segments[0]} segments of shared memory and are {self.segments[1]}")
        return found


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The soak's own arguments."""
    parser.add_argument("--minutes", type=float, default=60.0, help="in all, a quarter of it to warm up (60)")
    parser.add_argument("--every-s", type=float, default=1.0, help="a sample of each camera so often (1)")
    parser.add_argument("--size", default="640x360", help="WxH")


def run(args: argparse.Namespace) -> int:
    """Soak and print; exit code 5 if anything grew."""
    width, _, height = args.size.partition("x")
    if args.minutes <= 0 or not (width.isdecimal() and height.isdecimal()):
        print("bench soak: --minutes above 0, --size is WxH")
        return EXIT_USAGE
    with tempfile.TemporaryDirectory(prefix="tagmill-soak-") as folder:
        os.environ["TAGMILL_RUN_DIR"] = folder
        os.environ["TAGMILL_PREFIX"] = f"soak-{os.getpid()}"
        rig = _write_rig(Path(folder), (int(width), int(height)))
        log = Path(folder) / "stack.log"
        try:
            with running_stack(rig, log):
                soaked = soak(rig, args.minutes * 60, args.every_s)
        except TagmillError:
            print(log.read_text()[-4000:])
            raise
    if args.json:
        print(json.dumps({**asdict(soaked), "complaints": soaked.complaints}))
    else:
        _print(soaked)
    return EXIT_FOUND if soaked.complaints else EXIT_OK


def _write_rig(folder: Path, size: tuple[int, int]) -> Path:
    rig = yaml.safe_load(_OBJECTS.read_text())
    rig["dataset"] = {"root": "./dataset", "session": "soak"}
    rig["network"] = {"console": None}
    camera = {"driver": "synthetic", "width": size[0], "height": size[1], "fps": 10, "prerendered": 16}
    rig["cameras"] = {name: {**camera, "seed": number + 1} for number, name in enumerate(CAMERAS)}
    path = folder / "soak.yaml"
    path.write_text(yaml.safe_dump(rig))
    return path


def soak(rig: Path, seconds: float, every_s: float) -> Soaked:
    """Record, look again and again; raises TagmillError if the stack doesn't come up or doesn't record."""
    endpoints = Endpoints.of(load_rig(rig).config.network)
    with CommandClient(endpoints, timeout_s=30.0) as client:
        wait_ready(client, CAMERAS)
        started = client.request({"command": "start", "camera": "all", "every_s": every_s})
        if not started["ok"]:
            raise TagmillError(f"no recording was begun: {started['error']['message']}")
        client.request({"command": "record", "camera": "all", "timeout_s": 20.0})
        status = client.request({"command": "status"})
        pids = {name: int(service["pid"]) for name, service in status["services"].items()}
        growth: dict[str, Growth] = {name: Growth() for name in pids}
        began_ns, pause, segments = monotonic_ns(), Poller(), []
        while (elapsed_s := (monotonic_ns() - began_ns) / 1e9) < seconds:
            if elapsed_s >= seconds * _WARM_UP:
                _look(pids, growth, elapsed_s)
                segments.append(_segments(endpoints.prefix))
            pause.wait(seconds / _LOOKS)
            client.request({"command": "record", "camera": CAMERAS[0], "timeout_s": 20.0})
            status = client.request({"command": "status"})
        stopped = client.request({"command": "stop"}, timeout_s=60.0)
    restarted = [name for name, pid in pids.items() if int(status["services"][name]["pid"]) != pid]
    recorded = sum(one["recorded"] for ledger in stopped["ledgers"] for one in ledger["cameras"].values())
    for one in growth.values():
        one.mb_per_hour = slope(one)
    return Soaked(seconds, recorded, growth, (segments[0], segments[-1]), restarted)


def _look(pids: Mapping[str, int], growth: Mapping[str, Growth], elapsed_s: float) -> None:
    for name, pid in pids.items():
        memory, descriptors, processes = 0, 0, 0
        with suppress(psutil.NoSuchProcess):
            parent = psutil.Process(pid)
            for process in (parent, *parent.children(recursive=True)):
                memory += process.memory_full_info().uss
                descriptors += process.num_fds()
                processes += 1
        growth[name].memory_mb.append(round(memory / 1e6, 2))
        growth[name].descriptors.append(descriptors)
        growth[name].processes.append(processes)
        growth[name].at_s.append(round(elapsed_s, 1))


def _segments(prefix: str) -> int:
    return sum(path.name.startswith(f"tagmill-{prefix}-") for path in shm_folder().iterdir())


def slope(one: Growth) -> float | None:
    """MB an hour by least squares, over the looks since a worker was last begun or ended; None if that is too short."""
    counts = one.processes
    since = max((look for look in range(1, len(counts)) if counts[look] != counts[look - 1]), default=0)
    at_s, memory_mb = one.at_s[since:], one.memory_mb[since:]
    if len(at_s) < 3 or at_s[-1] - at_s[0] < SLOPE_OVER_S:
        return None
    return round(3600 * float(np.polyfit(at_s, memory_mb, 1)[0]), 2)


def _print(soaked: Soaked) -> None:
    rows = [
        [
            name,
            f"{one.memory_mb[0]:.1f}",
            f"{one.memory_mb[-1]:.1f}",
            "-" if one.mb_per_hour is None else f"{one.mb_per_hour:+.1f}",
            f"{one.descriptors[0]} ({min(one.descriptors)}-{max(one.descriptors)})",
            str(one.descriptors[-1]),
            f"{min(one.processes)}-{max(one.processes)}",
        ]
        for name, one in soaked.services.items()
    ]
    title = f"{soaked.seconds / 60:.0f} minutes, {soaked.samples} samples recorded; MB: what the processes would free"
    print_table(
        Console(highlight=False), title, ("", "MB first", "last", "MB/h", "fds first", "last", "processes"), rows
    )
    print(f"segments of shared memory: {soaked.segments[0]} first, {soaked.segments[1]} last")
    for line in soaked.complaints or ["nothing grew"]:
        print(line)
