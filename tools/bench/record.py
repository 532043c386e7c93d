"""`tagmill bench record`: how many samples a second become durable, what each step costs, against a plain script.

First a camera of 30 frames/s is recorded for the whole time: how many of its frames are lost? Then the stack and a
plain single-process script (``plain_recorder.py``) take turns with the same frames, each as fast as it can.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from common import clock
from common.bus import CommandClient, Endpoints
from common.config import load_rig
from common.config.dataset import DatasetConfig
from common.dataset import SessionReader
from common.errors import EXIT_OK, EXIT_USAGE, TagmillError
from tools.bench import plain_recorder
from tools.bench.processes import Usage, usage_between, usage_now
from tools.bench.record_rig import CAMERA, FPS, SESSION, render, save_for_script, write_rig
from tools.bench.record_steps import Steps
from tools.bench.record_table import print_disk, print_record
from tools.bench.settled import settled
from tools.stack.running import running_stack, wait_ready

ROUNDS = 3
_SAMPLE_BYTES = 2_500_000
_FASTEST = 60
"""Samples a second that the disk must have room for where nothing paces them."""
_RESERVE_BYTES = 1_000_000_000
_SETTLE_S = 120.0
_CHECKED = 25


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The benchmark's own arguments."""
    parser.add_argument("--seconds", type=float, default=30.0, help="of each of the two measurements (30)")
    parser.add_argument(
        "--source",
        choices=("both", "camera", "fastest"),
        default="both",
        help="a camera of 30 frames/s, or one as fast as its frames are taken, in turn with the script (both)",
    )
    parser.add_argument(
        "--format", choices=("png", "jpeg", "webp"), default="png", help="of the stack's pictures (png)"
    )
    parser.add_argument(
        "--root",
        type=Path,
        default=Path(),
        metavar="DIR",
        help="where to record (.); a folder there is made and removed",
    )


@dataclass
class Recorded:
    """What the stack did in one measurement. Rates are over the time until the last sample was durable.

    ``refused`` and ``dropped`` by reason; ``checked`` samples were read back, whole and with the right pictures.
    """

    seconds: float
    captured: int
    recorded: int
    refused: dict[str, int]
    dropped: dict[str, int]
    samples_per_s: float
    megabytes_per_s: float
    steps_ms: dict[str, float]
    processes: dict[str, Usage]
    checked: int

    def cpu_ms(self) -> dict[str, float]:
        """CPU time a sample by service, its workers and all around the steps included."""
        each_ms = 10 * self.seconds / max(self.recorded, 1)
        return {name: usage.cpu_percent * each_ms for name, usage in self.processes.items()}


@dataclass
class Script:
    """What the plain script did."""

    samples_per_s: list[float]
    megabytes_per_s: float
    steps_ms: dict[str, float]


@dataclass
class Result:
    """The whole benchmark; ``fastest`` is the mean of the turns, ``ratios`` one a turn."""

    fill: str
    script_fill: str
    picture_format: str
    camera: Recorded | None = None
    fastest: list[Recorded] | None = None
    script: Script | None = None
    ratios: list[float] | None = None


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    if args.seconds <= 0 or not args.root.is_dir():
        print("bench record: --seconds is above 0, --root a folder that exists")
        return EXIT_USAGE
    needed = _needed(args.source, args.seconds)
    free = shutil.disk_usage(args.root).free
    if not args.json:
        print_disk(args.root, needed, free)
    if free < needed + _RESERVE_BYTES:
        print(f"bench record: {args.root} has {free / 1e9:.1f} GB free; it needs {needed / 1e9:.1f} and 1 to spare")
        return EXIT_USAGE
    with tempfile.TemporaryDirectory(prefix="tagmill-record-", dir=args.root) as folder:
        result = _measure(Path(folder).absolute(), args)
    print(json.dumps(asdict(result))) if args.json else print_record(result, args.seconds)
    return EXIT_OK


def _needed(source: str, seconds: float) -> int:
    """Bytes for the most that may be recorded."""
    camera = FPS * seconds if source != "fastest" else 0
    fastest = _FASTEST * seconds / 2 if source != "camera" else 0
    return int((camera + fastest) * _SAMPLE_BYTES)


def _measure(folder: Path, args: argparse.Namespace) -> Result:
    result = Result(
        fill=load_rig(write_rig(folder, folder, paced=False, picture_format=args.format)).config.inpaint.method,
        script_fill=f"telea (radius {plain_recorder.TELEA_RADIUS_PX:g} px, whole picture)",
        picture_format=DatasetConfig(format=args.format).format,
    )
    if args.source != "fastest":
        rig = write_rig(folder, folder / "camera", paced=False, picture_format=args.format)
        with _stack(folder, rig) as stack:
            result.camera = stack.record(args.seconds)
            stack.check([result.camera])
    if args.source != "camera":
        rig = write_rig(folder, folder / "fastest", paced=True, picture_format=args.format)
        save_for_script(rig, folder)
        with _stack(folder, rig) as stack:
            _turns(result, stack, folder, args.seconds / 2 / ROUNDS)
    return result


def _turns(result: Result, stack: _Stack, folder: Path, seconds: float) -> None:
    """The script and the stack in turn; the stack's camera stands still while the script has its turn."""
    result.fastest, result.ratios, outputs = [], [], []
    for _ in range(ROUNDS):
        with stack.camera_stopped():
            outputs.append(_run_script(folder, seconds))
        result.fastest.append(stack.record(seconds))
        result.ratios.append(result.fastest[-1].samples_per_s / (outputs[-1]["samples"] / outputs[-1]["seconds"]))
    stack.check(result.fastest)
    result.script = Script(
        samples_per_s=[out["samples"] / out["seconds"] for out in outputs],
        megabytes_per_s=sum(out["bytes"] for out in outputs) / sum(out["seconds"] for out in outputs) / 1e6,
        steps_ms={name: float(np.mean([out["steps_ms"][name] for out in outputs])) for name in outputs[0]["steps_ms"]},
    )


def _run_script(folder: Path, seconds: float) -> plain_recorder.Output:
    command = [sys.executable, str(Path(plain_recorder.__file__)), str(folder), str(seconds)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=seconds + 120, check=False)
    shutil.rmtree(folder / "out", ignore_errors=True)
    if done.returncode:
        raise TagmillError(f"the plain script failed: {done.stderr.strip()[-500:]}")
    output: plain_recorder.Output = json.loads(done.stdout)
    return output


class _Stack:
    """A running stack that records on demand."""

    def __init__(self, rig: Path, client: CommandClient, endpoints: Endpoints) -> None:
        self._rig, self._client, self._endpoints = rig, client, endpoints
        status = wait_ready(client, [CAMERA])
        self._pids = {name: int(service["pid"]) for name, service in status["services"].items()}

    @contextmanager
    def camera_stopped(self) -> Iterator[None]:
        """Its capture process stands still, so that the stack idles."""
        pid = self._pids[f"capture.{CAMERA}"]
        os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(pid, signal.SIGCONT)

    def record(self, seconds: float) -> Recorded:
        """Record every frame for so long, and wait until all of it is durable."""
        with Steps(self._endpoints) as steps:
            before, began = usage_now(self._pids), clock.monotonic_ns()
            bytes_before = steps.bytes_written
            started = self._client.request({"command": "start", "camera": CAMERA, "every_s": 0})
            if not started["ok"]:
                raise TagmillError(f"the recording didn't start: {started['error']['message']}")
            steps.listen(seconds)
            ledger = self._settled(started["recording"])
            took_s = (clock.monotonic_ns() - began) / 1e9
            usage = usage_between(before, usage_now(self._pids))
            steps.listen_once()
            return Recorded(
                seconds=took_s,
                captured=ledger["captured"],
                recorded=ledger["recorded"],
                refused=ledger["refused"],
                dropped=ledger["dropped"],
                samples_per_s=ledger["recorded"] / took_s,
                megabytes_per_s=(steps.bytes_written - bytes_before) / took_s / 1e6,
                steps_ms=steps.means(),
                processes=usage,
                checked=0,
            )

    def _settled(self, recording: str) -> dict[str, Any]:
        """Stop, and wait until all of it is durable; the camera's account."""
        ledger = settled(self._client, recording, _SETTLE_S)
        account: dict[str, Any] = ledger["cameras"][CAMERA]
        return account

    def check(self, recorded: list[Recorded]) -> None:
        """Read samples back; raises TagmillError if one is not whole, or not of a frame that the camera gave."""
        depths = {frame.tobytes() for frame in render(self._rig)[1]}
        session = SessionReader(load_rig(self._rig).dataset_root / SESSION)
        names = sorted(session.samples())
        chosen = names[:: max(len(names) // _CHECKED, 1)]
        for name in chosen:
            label = session.label(name)
            session.verify(label)
            depth = session.depth(label)
            if depth is None or depth.tobytes() not in depths or not label.objects:
                raise TagmillError(f"sample {name} is not of a frame that the camera gave")
        expected = sum(item.recorded for item in recorded)
        if len(names) != expected:
            raise TagmillError(f"the ledger says {expected} samples, {len(names)} are on the disk")
        for item in recorded:
            item.checked = len(chosen)


@contextmanager
def _stack(folder: Path, rig: Path) -> Iterator[_Stack]:
    os.environ["TAGMILL_RUN_DIR"] = str(folder / f"run-{rig.stem}")
    os.environ["TAGMILL_PREFIX"] = f"record-{os.getpid()}"
    endpoints = Endpoints.of(load_rig(rig).config.network)
    log = folder / f"{rig.stem}.log"
    try:
        with running_stack(rig, log), CommandClient(endpoints, timeout_s=10.0) as client:
            yield _Stack(rig, client, endpoints)
    except TagmillError:
        print(log.read_text()[-4000:], file=sys.stderr)
        raise
