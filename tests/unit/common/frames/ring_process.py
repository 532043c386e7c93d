"""A process that writes a ring at full speed, or reads one and checks each frame. Prints JSON lines.

``python -m tests.unit.common.frames.ring_process ROLE NAME [COUNT]``; every role ends when its stdin does.
"""

from __future__ import annotations

import json
import os
import random
import select
import sys
import time

import numpy as np

from common.errors import FrameLostError
from common.frames import FrameReader, FrameWriter

WIDTH, HEIGHT, SLOTS = 160, 120, 4
DEADLINE_S = 60.0


def say(**what: object) -> None:
    print(json.dumps(what), flush=True)


def told_to_end() -> bool:
    return bool(select.select([sys.stdin], [], [], 0)[0])


def colour_of(number: int) -> int:
    return number * 37 % 251


def is_whole(bgr: np.ndarray, depth: np.ndarray, number: int) -> bool:
    """Whether every pixel is of frame ``number``; looks twice, so that a change in between shows too."""
    wanted, far = colour_of(number), number % 65536
    return all((bgr.min(), bgr.max(), depth.min(), depth.max()) == (wanted, wanted, far, far) for _ in range(2))


def write(name: str) -> None:
    with FrameWriter(name, WIDTH, HEIGHT, True, SLOTS) as ring:
        say(ready=True, pid=os.getpid())
        while not told_to_end():
            for _ in range(50):
                number = ring.newest + 1

                def fill(bgr: np.ndarray, depth: np.ndarray | None, number: int = number) -> None:
                    bgr[:] = colour_of(number)
                    assert depth is not None
                    depth[:] = number % 65536

                ring.write(None, fill=fill)
        say(written=ring.newest)


def read(name: str, wanted: int) -> None:
    """Accept ``wanted`` frames, mostly the oldest that are still there: these are overwritten first."""
    accepted = torn = lost = 0
    chance = random.Random(os.getpid())
    deadline = time.monotonic() + DEADLINE_S
    with FrameReader(name) as ring:
        while accepted < wanted and time.monotonic() < deadline:
            number = ring.newest() - chance.choice((0, 0, 1, 2, 3))
            try:
                with ring.view(number) as frame:
                    assert frame.depth is not None
                    whole = is_whole(frame.bgr, frame.depth, number)
            except FrameLostError:
                lost += 1
                continue
            accepted += 1
            torn += not whole
    say(accepted=accepted, torn=torn, lost=lost)


def read_unguarded(name: str) -> None:
    """The control: the same reading without asking the ring; ends when it has met a torn frame."""
    deadline = time.monotonic() + DEADLINE_S
    torn = reads = 0
    with FrameReader(name) as ring:
        while not torn and time.monotonic() < deadline:
            number = ring.newest()
            frame = ring.layout.pictures(ring._segment.buffer, number % SLOTS)
            assert frame.depth is not None
            torn += not is_whole(frame.bgr, frame.depth, number)
            reads += 1
        say(torn=torn, reads=reads)


def hold(name: str) -> None:
    """Enter a frame, say so, and leave it when told to."""
    deadline = time.monotonic() + DEADLINE_S
    with FrameReader(name) as ring:
        inside = False
        while not inside and time.monotonic() < deadline:
            try:
                with ring.view(ring.newest()):
                    inside = True
                    say(inside=True, pid=os.getpid())
                    sys.stdin.readline()
            except FrameLostError:
                outcome = "lost"
            else:
                outcome = "whole"
        say(outcome=outcome)


if __name__ == "__main__":
    role, segment, *rest = sys.argv[1:]
    match role:
        case "write":
            write(segment)
        case "read":
            read(segment, int(rest[0]))
        case "read-unguarded":
            read_unguarded(segment)
        case "hold":
            hold(segment)
