"""What every frame of the cameras must look like, written down before anything goes wrong."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from common.config import load_rig
from services.capture.cameras.registry import load_driver
from tools.bench.chaos.ground import AHEAD, FPS

STRIP_PX = 50
"""Rows at the top that the burnt number may touch; they aren't compared."""


def write_truth(rig_path: Path, path: Path) -> None:
    """For each camera: checksums of picture and depth, and where the markers are, of each step of its path.

    The camera goes there and back over the frames that it rendered ahead, so frame n is step n modulo their number.
    """
    rig = load_rig(rig_path)
    cameras: dict[str, Any] = {}
    for name, config in rig.config.cameras.items():
        camera = load_driver(config.driver)(name, config, rig)
        steps = []
        try:
            for _ in range(2 * AHEAD - 2):
                frame = camera.grab(5.0)
                assert frame.depth is not None
                steps.append(
                    {
                        "picture": hashlib.sha256(frame.bgr[STRIP_PX:].tobytes()).hexdigest(),
                        "depth": hashlib.sha256(frame.depth.tobytes()).hexdigest(),
                        "markers": {marker.id: marker.corners for one in frame.truth or () for marker in one.markers},
                    }
                )
        finally:
            camera.close()
        cameras[name] = {"fps": FPS, "strip_px": STRIP_PX, "steps": steps}
    path.write_text(json.dumps(cameras))
