"""The demo's script: start the stack, record, plug a second camera in, record, stop, compare, show."""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from common import clock
from common.bus import CommandClient, Endpoints, Subscriber
from common.config import load_rig
from common.dataset import SessionReader
from common.errors import EXIT_INTERRUPTED, EXIT_REFUSED, EXIT_USAGE, TagmillError
from common.messages import TrueObject, Truth
from common.topics import TRUTH
from tools.demo.show import show
from tools.stack.programs import CAMERAS_FOLDER, CONFIG_FILE, ROOT
from tools.stack.running import interrupt_by_sigterm, running_stack, wait_ready

RIG = Path(__file__).with_name("rig.yaml")
SECOND_CAMERA = ROOT / "deploy" / "examples" / "conf.d"
_RECORD_S = 120.0
LEAST_RATE = 10.0

Truths = dict[tuple[str, int], tuple[TrueObject, ...]]


def main(argv: list[str] | None = None) -> int:
    """Run the demo; 0 if everything that it shows is true."""
    parser = argparse.ArgumentParser(prog="python -m tools.demo", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("demo-out"), help="folder for the dataset and the sheet")
    out: Path = parser.parse_args(argv).out.resolve()
    console = Console(highlight=False)
    if out.exists() and any(out.iterdir()) and not (out / "dataset" / "demo").is_dir():
        console.print(f"{out} holds something else than an earlier demo; name another folder with --out.")
        return EXIT_USAGE
    interrupt_by_sigterm()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    rig_path = Path(shutil.copy(RIG, out / "rig.yaml"))
    with tempfile.TemporaryDirectory(prefix="tagmill-demo-") as run:
        os.environ["TAGMILL_RUN_DIR"] = run
        os.environ["TAGMILL_PREFIX"] = prefix = f"demo-{os.getpid()}"
        try:
            with running_stack(rig_path, out / "stack.log"):
                truths, rates = record(rig_path, Path(run) / prefix, console)
        except TagmillError as error:
            console.print(f"[bold]The demo failed:[/] {error.message}\nThe stack's log is {out / 'stack.log'}")
            return error.exit_code
        except KeyboardInterrupt:
            console.print(f"Interrupted. What there is lies in {out}; the next run begins anew.")
            return EXIT_INTERRUPTED
        left = sorted(path.name for path in Path("/dev/shm").glob(f"tagmill-{prefix}-*"))  # noqa: S108 - where rings are
    session = SessionReader(out / "dataset" / "demo")
    good = show(session, truths, out / "contact-sheet.png", console)
    if left:
        console.print(f"Left behind in shared memory: {', '.join(left)}")
    console.print(f"Dataset: {session.folder}\nContact sheet: {out / 'contact-sheet.png'}", soft_wrap=True)
    slow = [name for name, rate in rates.items() if rate < LEAST_RATE]
    if slow:
        console.print(f"{', '.join(slow)} gave less than {LEAST_RATE:g} frames/s: is the machine busy otherwise?")
    return 0 if good and not left and not slow else EXIT_REFUSED


def record(rig_path: Path, run: Path, console: Console) -> tuple[Truths, dict[str, float]]:
    """Twelve samples from the first camera, then the second camera, then six from both; and the frame rates."""
    endpoints = Endpoints.of(load_rig(rig_path).config.network)
    truths: Truths = {}
    subscriber = Subscriber(endpoints)
    subscriber.subscribe(TRUTH)
    client = CommandClient(endpoints, timeout_s=5.0)
    try:
        before = wait_ready(client, {"cam0"})
        began = clock.monotonic_ns()
        console.print("The stack is up: cam0 1280x720 RGB-D, two boxes. Recording 12 samples ...")
        take(client, subscriber, truths, "cam0", 12)
        plug_in(run)
        drain = partial(listen, subscriber, truths)
        wait_ready(client, {"cam0", "cam1"}, meanwhile=drain)
        console.print("cam1 was plugged in while the stack ran. Recording 6 samples from each ...")
        take(client, subscriber, truths, "all", 6)
        after = client.request({"command": "status"})
        rates = _rates(before, after, clock.monotonic_ns() - began)
        console.print("Frame rates reached: " + ", ".join(f"{name} {rate:.1f}/s" for name, rate in rates.items()))
    finally:
        client.close()
        subscriber.close()
    return truths, rates


def take(client: CommandClient, subscriber: Subscriber, truths: Truths, camera: str, count: int) -> None:
    """Record ``count`` samples a camera, one by one, and keep the truth of all frames that pass meanwhile."""
    for _ in range(count):
        listen(subscriber, truths)
        answer = client.request(
            {"command": "record", "camera": camera, "timeout_s": _RECORD_S}, timeout_s=_RECORD_S + 5
        )
        listen(subscriber, truths)
        if not answer["ok"]:
            raise TagmillError(f"a record was refused: {answer['error']['message']}")


def listen(subscriber: Subscriber, truths: Truths) -> None:
    """Keep the truth of the frames that passed since the last time."""
    for received in subscriber.receive():
        if isinstance(received.message, Truth):
            truths[received.message.camera, received.message.frame] = received.message.objects


def plug_in(run: Path) -> None:
    """What the how-to says: two small files into the running stack's conf.d, then `supervisorctl update`."""
    for file in sorted(SECOND_CAMERA.iterdir()):
        shutil.copy(file, run / CAMERAS_FOLDER)
    update = [sys.executable, "-m", "supervisor.supervisorctl", "-c", str(run / CONFIG_FILE), "update"]
    done = subprocess.run(update, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise TagmillError(f"supervisorctl update failed: {done.stdout.strip()} {done.stderr.strip()}")


def _rates(before: dict[str, Any], after: dict[str, Any], elapsed_ns: int) -> dict[str, float]:
    """Frames per second of each camera: cam0's over the whole recording, a later camera's as its process says."""
    rates = {}
    for name, camera in after["cameras"].items():
        earlier = before["cameras"].get(name)
        if earlier is not None:
            rates[name] = (camera["captured"] - earlier["captured"]) * 1e9 / elapsed_ns
        else:
            rates[name] = after["services"][f"capture.{name}"]["rates"].get("captured", 0.0)
    return rates
