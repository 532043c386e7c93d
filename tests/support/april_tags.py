"""An independent detector: the AprilTag library (pupil-apriltags, decimate 1), in a process of its own.

The wrapper's destructor corrupts the heap, with one detector as with several; its process ends before that runs.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Corners = list[list[float]]


def april_tags(pictures: Sequence[NDArray[np.uint8]], family: str = "tag36h11") -> list[list[int]]:
    """The ids found in each grey picture (H, W)."""
    return [[tag for tag, _ in found] for found in april_tag_corners(pictures, family)]


def april_tag_corners(
    pictures: Sequence[NDArray[np.uint8]], family: str = "tag36h11"
) -> list[list[tuple[int, Corners]]]:
    """The ids found in each grey picture (H, W), ascending, with four corners as the library gives them."""
    packed = io.BytesIO()
    np.savez(packed, *pictures)
    child = [sys.executable, __file__, family]
    done = subprocess.run(child, input=packed.getvalue(), stdout=subprocess.PIPE, timeout=120, check=True)
    found: list[list[tuple[int, Corners]]] = json.loads(done.stdout)
    return found


def _main(family: str) -> None:
    from pupil_apriltags import Detector

    detector = Detector(family, quad_decimate=1.0)
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as pictures:
        found = [
            sorted((int(tag.tag_id), np.asarray(tag.corners).tolist()) for tag in detector.detect(pictures[name]))
            for name in pictures.files
        ]
    sys.stdout.write(json.dumps(found))
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    _main(sys.argv[1])
