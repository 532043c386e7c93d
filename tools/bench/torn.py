"""`tagmill bench torn`: a camera's ring written as fast as it goes, read by slow and quick readers with checksums.

Every frame is noise, its number and its checksum lie in its last pixels. A reader that was too slow must be told
(`FrameLostError`); a frame that it was given must have its checksum. As the control, one reader doesn't ask the
ring whether the frame is still there: it does meet torn frames, so the others could have.
"""

from __future__ import annotations

import argparse
import json
import os
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from common.bus import Poller
from common.clock import monotonic_ns
from common.errors import EXIT_FOUND, EXIT_OK, EXIT_USAGE, FrameLostError, TagmillError
from common.frames import FrameReader, FrameWriter, segment_name, sweep
from tools.report.table import print_table

_WIDTH, _HEIGHT, _SLOTS = 640, 360, 6
_SIGNED_BYTES = 16
_START_S = 120.0
_PATTERNS = 8
_LOOK_EVERY = 50
_READERS = {"quick": 0.0, "slow by 2 ms": 0.002, "slow by 20 ms": 0.02, "not asking the ring": 0.0}
UNGUARDED = "not asking the ring"

Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class Readings:
    """What one reader saw: frames whose checksum fitted, frames it was told it had lost, frames with wrong pixels."""

    reader: str
    whole: int
    lost: int
    torn: int


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The stress test's own arguments."""
    parser.add_argument("--seconds", type=float, default=600.0, help="how long (600: ten minutes)")


def run(args: argparse.Namespace) -> int:
    """Write and read, print; exit code 5 if a guarded reader was given a torn frame."""
    if args.seconds <= 0:
        print("bench torn: --seconds above 0")
        return EXIT_USAGE
    written, readings = stress(args.seconds)
    torn = sum(one.torn for one in readings if one.reader != UNGUARDED)
    if args.json:
        print(json.dumps({"written": written, "torn": torn, "readers": [asdict(one) for one in readings]}))
    else:
        print_table(
            Console(highlight=False),
            f"{written} frames of {_WIDTH}x{_HEIGHT} RGB-D written in {args.seconds:g} s into {_SLOTS} slots",
            ("reader", "whole", "told lost", "torn"),
            [[one.reader, str(one.whole), str(one.lost), str(one.torn)] for one in readings],
        )
    return EXIT_FOUND if torn else EXIT_OK


def stress(seconds: float) -> tuple[int, list[Readings]]:
    """How many frames were written, and what each reader saw; raises TagmillError if a process doesn't come up."""
    name = segment_name(f"torn{os.getpid()}", "cam0", "00000001")
    actors: list[tuple[BaseProcess, Connection]] = []
    try:
        actors.append(_start(_write, name))
        _hear(actors[0][1], _START_S)
        for reader, pause_s in _READERS.items():
            actors.append(_start(_read, name, seconds, reader, pause_s))
        seen = [_hear(pipe, seconds + _START_S) for _, pipe in actors[1:]]
        actors[0][1].send("enough")
        return int(str(_hear(actors[0][1], _START_S))), [one for one in seen if isinstance(one, Readings)]
    finally:
        for process, _ in actors:
            process.kill()
            process.join()
        sweep(f"torn{os.getpid()}")


def _start(role: Callable[..., None], *arguments: object) -> tuple[BaseProcess, Connection]:
    here, there = get_context("spawn").Pipe()
    process = get_context("spawn").Process(target=role, args=(there, *arguments), daemon=True)
    process.start()
    there.close()
    return process, here


def _hear(pipe: Connection, limit_s: float) -> object:
    try:
        if pipe.poll(limit_s):
            return pipe.recv()
    except EOFError:
        raise TagmillError("a process of the stress test has died; see what it said above") from None
    raise TagmillError(f"a process of the stress test said nothing for {limit_s:g} s")


def _write(pipe: Connection, name: str) -> None:
    patterns = [np.random.default_rng(number).integers(0, 256, _frame_bytes(), np.uint8) for number in range(_PATTERNS)]
    with FrameWriter(name, _WIDTH, _HEIGHT, True, _SLOTS) as ring:
        pipe.send("ready")
        while ring.newest % _LOOK_EVERY or not pipe.poll():
            number = ring.newest + 1
            pattern = patterns[number % _PATTERNS]
            pattern[:8].view(np.uint64)[0] = number

            def fill(bgr: Bytes, depth: NDArray[np.uint16] | None, pattern: Bytes = pattern) -> None:
                assert depth is not None
                colour = bgr.reshape(-1)
                np.copyto(colour, pattern[: colour.size])
                np.copyto(depth.reshape(-1).view(np.uint8), pattern[colour.size :])
                # Last of all: the checksum of what should be there, not of what is.
                depth.reshape(-1).view(np.uint8)[-8:].view(np.uint64)[0] = zlib.crc32(pattern[:-_SIGNED_BYTES].data)

            ring.write(None, fill=fill)
        pipe.send(ring.newest)


def _frame_bytes() -> int:
    return _WIDTH * _HEIGHT * 5


def _read(pipe: Connection, name: str, seconds: float, reader: str, pause_s: float) -> None:
    whole = lost = torn = 0
    pause, until = Poller(), monotonic_ns() + int(seconds * 1e9)
    with FrameReader(name) as ring:
        while monotonic_ns() < until:
            number = ring.newest()
            fits: bool | None = None  # None: not even begun
            try:
                with ring.view(number) as frame:
                    assert frame.depth is not None
                    if pause_s:
                        pause.wait(pause_s)
                    fits = _fits(frame.bgr, frame.depth, number)
            except FrameLostError:
                # The control takes what it saw all the same, as a reader would that doesn't look at the numbers.
                if reader != UNGUARDED or fits is None:
                    lost += 1
                    continue
            whole, torn = whole + bool(fits), torn + (not fits)
    pipe.send(Readings(reader, whole, lost, torn))


def _fits(bgr: Bytes, depth: NDArray[np.uint16], number: int) -> bool:
    """Whether picture and depth are wholly those of frame ``number``, by the checksum that lies in them."""
    colour, far = bgr.reshape(-1), depth.reshape(-1).view(np.uint8)
    if int(colour[:8].view(np.uint64)[0]) != number:
        return False
    checksum = zlib.crc32(far[:-_SIGNED_BYTES].data, zlib.crc32(colour.data))
    return checksum == int(far[-8:].view(np.uint64)[0])
