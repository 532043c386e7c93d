"""`tagmill bench bus`: latency and CPU of a 1280x720 RGB-D frame from capture to 1, 2, 4, 8 readers.

Our ring with its news over ZeroMQ against the pixels themselves over ZeroMQ (ipc, tcp, without copies where it can) and
over iceoryx2 (``pip install iceoryx2``). All ways take turns in one run, with the same announcement for each frame. A
reader forms the grey picture, in place, or of a full copy of picture and depth; a ZeroMQ message is its reader's own
memory, so there the two are one.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from common.errors import EXIT_OK, EXIT_USAGE, TagmillError
from tools.bench.bus.frames import Form
from tools.bench.bus.result import Case, Result, print_results, summed_up

_TCP = "tcp://127.0.0.1:{port}"


@dataclass(frozen=True)
class Way:
    """One way to hand frames on: its name in the table, who does it, where, and what the reader does."""

    name: str
    way: str
    place: str
    form: Form


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The benchmark's own arguments."""
    parser.add_argument("--readers", default="1,2,4,8", help="how many readers, one measurement each (1,2,4,8)")
    parser.add_argument("--fps", type=float, default=20.0, help="frames/s (20: eight readers of raw ZeroMQ keep up)")
    parser.add_argument("--frames", type=int, default=16, help="frames a measurement (16)")
    parser.add_argument("--rounds", type=int, default=3, help="every way takes its turn so often (3)")
    parser.add_argument("--port", type=int, default=5799, help="loopback port for ZeroMQ over tcp (5799)")


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    if not re.fullmatch(r"\d+(,\d+)*", args.readers) or min(args.fps, args.frames, args.rounds) <= 0:
        print("bench bus: --readers like 1,2,4,8; --fps, --frames and --rounds above 0")
        return EXIT_USAGE
    readers = [int(count) for count in args.readers.split(",")]
    with tempfile.TemporaryDirectory(prefix="tagmill-bus-") as folder:
        os.environ["TAGMILL_RUN_DIR"] = folder
        os.environ["TAGMILL_PREFIX"] = f"bus-{os.getpid()}"
        ways = _ways(Path(folder), args.port)
        results = measure(ways, readers, args)
    document = summed_up(results)
    if args.json:
        print(json.dumps({"results": [asdict(one) for one in results], **document}))
    else:
        print_results(results, document, args)
    return EXIT_OK


def _ways(folder: Path, port: int) -> list[Way]:
    ways = [
        Way("ring, grey in place", "ring", "", "grey"),
        Way("ring, full copy", "ring", "", "copy"),
        Way("ZeroMQ ipc", "zmq", f"ipc://{folder}/raw", "grey"),
        Way("ZeroMQ tcp", "zmq", _TCP.format(port=port), "grey"),
    ]
    if importlib.util.find_spec("iceoryx2") is None:
        print("iceoryx2 is not installed, so it takes no part (pip install iceoryx2)", file=sys.stderr)
        return ways
    place = f"tagmill-{os.getpid()}"
    return [
        *ways,
        Way("iceoryx2, grey in place", "iceoryx2", place, "grey"),
        Way("iceoryx2, full copy", "iceoryx2", place, "copy"),
    ]


def measure(ways: list[Way], readers: list[int], args: argparse.Namespace) -> list[Result]:
    """Each way with each number of readers, round by round."""
    results = []
    with ExitStack() as actors:
        proxy = actors.enter_context(_actor("proxy"))
        proxy.hear()
        producer = actors.enter_context(_actor("producer"))
        crowd = [actors.enter_context(_actor("reader")) for _ in range(max(readers))]
        for round_ in range(args.rounds):
            for count in readers:
                for way in ways:
                    case = Case(way.name, count, round_)
                    results.append(_one(case, way, proxy, producer, crowd[:count], args))
    return results


def _one(
    case: Case, way: Way, proxy: _Actor, producer: _Actor, readers: list[_Actor], args: argparse.Namespace
) -> Result:
    producer.tell(way=way.way, place=way.place)
    producer.hear()
    for reader in readers:
        reader.tell(way=way.way, place=way.place, form=way.form, frames=args.frames)
    for reader in readers:
        reader.hear()
    producer.tell(frames=args.frames, fps=args.fps)
    producer.hear()
    proxy.tell()
    before = proxy.hear()["cpu_s"]
    producer.hear()
    heard = [reader.hear() for reader in readers]
    producer.tell()
    sent = producer.hear()["cpu_s"]
    proxy.tell()
    carried = proxy.hear()["cpu_s"] - before
    cpu_ms = 1000 * (sent + carried + sum(one["cpu_s"] for one in heard)) / args.frames
    late = [ms for one in heard for ms in one["late_ms"]]
    return Result(case, round(cpu_ms, 3), late, sum(one["lost"] for one in heard))


class _Actor:
    """One process of actors.py."""

    def __init__(self, popen: subprocess.Popen[str], role: str) -> None:
        self._popen, self._role = popen, role

    def tell(self, **order: Any) -> None:
        """An order."""
        assert self._popen.stdin is not None
        self._popen.stdin.write(json.dumps(order) + "\n")
        self._popen.stdin.flush()

    def hear(self) -> dict[str, Any]:
        """What it says next; raises TagmillError if it has ended."""
        assert self._popen.stdout is not None
        line = self._popen.stdout.readline()
        if not line:
            raise TagmillError(f"the {self._role} of the benchmark has ended; see what it said above")
        answer: dict[str, Any] = json.loads(line)
        return answer


@contextmanager
def _actor(role: str) -> Iterator[_Actor]:
    popen = subprocess.Popen(
        [sys.executable, "-m", "tools.bench.bus.actors", role],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield _Actor(popen, role)
    finally:
        assert popen.stdin is not None
        popen.stdin.close()
        try:
            popen.wait(10)
        except subprocess.TimeoutExpired:
            popen.kill()
            popen.wait()
        assert popen.stdout is not None
        popen.stdout.close()
