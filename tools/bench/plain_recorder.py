"""The script that somebody would write instead of tagmill, for `tagmill bench record`: one process, one loop.

cv2's detector, solvePnP, Telea over the whole picture, cv2's PNG, open and write; all with their defaults, nothing
synced to the disk. Runs as ``python plain_recorder.py FOLDER SECONDS``: reads ``frames.npz`` there (which stands
in for the camera), records into ``out/``, prints JSON: samples, seconds, bytes, ms by step.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any, TypedDict

import cv2
import numpy as np

TELEA_RADIUS_PX = 3.0
MARGIN = 0.3
"""Beyond the marker, as a share of it: its white border and what the blur leaves."""


class Output(TypedDict):
    """What it prints."""

    samples: int
    seconds: float
    bytes: int
    steps_ms: dict[str, float]


def main(folder: Path, seconds: float) -> Output:
    """Record for so long."""
    data = np.load(folder / "frames.npz")
    colour, depth = data["colour"], data["depth"]
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    out = folder / "out"
    out.mkdir()
    spent: dict[str, float] = {}
    samples = size = 0
    began = time.perf_counter()
    while time.perf_counter() - began < seconds:
        step = samples % len(colour)
        laps, written = record(detector, data, colour[step].copy(), depth[step], out, samples)
        for name, lap in laps.items():
            spent[name] = spent.get(name, 0.0) + lap
        samples, size = samples + 1, size + written
    elapsed = time.perf_counter() - began
    steps = {name: total / samples * 1e3 for name, total in spent.items()}
    return {"samples": samples, "seconds": elapsed, "bytes": size, "steps_ms": steps}


def record(detector: Any, data: Any, bgr: Any, depth: Any, out: Path, number: int) -> tuple[dict[str, float], int]:
    """One sample: seconds by step, and bytes."""
    laps: dict[str, float] = {}
    at = time.perf_counter()

    def lap(name: str) -> None:
        nonlocal at
        now = time.perf_counter()
        laps[name], at = now - at, now

    corners, ids, _ = detector.detectMarkers(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY))
    lap("detect")
    # cv2 has AprilTag dictionaries upside down: its first corner is the marker's bottom right one.
    seen = [(int(id_), np.roll(quad.reshape(4, 2), 2, axis=0)) for quad, id_ in zip(corners, ids.ravel(), strict=True)]
    known = np.concatenate([data["marker_corners"][id_] for id_, _ in seen])
    pixels = np.concatenate([quad for _, quad in seen])
    _, rvec, tvec = cv2.solvePnP(known, pixels.astype(np.float64), data["matrix"], None)
    box = cv2.projectPoints(data["box"], rvec, tvec, data["matrix"], None)[0].reshape(8, 2)
    lap("pose")
    mask = np.zeros(bgr.shape[:2], np.uint8)
    for _, quad in seen:
        middle = quad.mean(axis=0)
        cv2.fillConvexPoly(mask, np.rint(middle + (quad - middle) * (1 + 2 * MARGIN)).astype(np.int32), 255)
    erased = cv2.inpaint(bgr, mask, TELEA_RADIUS_PX, cv2.INPAINT_TELEA)
    lap("erase")
    files = {"rgb": cv2.imencode(".png", erased)[1].tobytes(), "depth": cv2.imencode(".png", depth)[1].tobytes()}
    lap("encode")
    label = {
        "rvec": rvec.ravel().tolist(),
        "tvec_mm": tvec.ravel().tolist(),
        "corners": box.tolist(),
        "window": [*box.min(axis=0).tolist(), *box.max(axis=0).tolist()],
        "markers": {id_: quad.tolist() for id_, quad in seen},
    }
    files["label"] = json.dumps(label).encode()
    for kind, content in files.items():
        with (out / f"{kind}_{number:06d}.{'json' if kind == 'label' else 'png'}").open("wb") as file:
            file.write(content)
    lap("write")
    return laps, sum(map(len, files.values()))


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]), float(sys.argv[2]))))
