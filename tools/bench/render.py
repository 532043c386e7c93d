"""`tagmill bench render`: what a frame of the synthetic camera costs, in CPU time of one core.

The boxes of a rig (default: the demo's two) move on their path; each frame is rendered in all variants in turn, so a
noisy machine hits them alike. Times are process times: waiting for the core doesn't count, sharing its caches does.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console

from common.config import load_rig
from common.errors import EXIT_OK
from common.geometry import CameraModel
from common.markers import family
from common.scene import Rendered, Scene, SceneCamera
from tools.report.table import print_table

DEMO = Path(__file__).parents[1] / "demo" / "rig.yaml"
STEP = 7
"""Frames of the path from one rendered frame to the next: the boxes show all their sides."""
FOCAL_PER_WIDTH = 0.72
"""As of the synthetic driver."""
_COLUMNS = ("variant", "median ms", "p95", "min", "ratio")

Render = Callable[[int], Rendered]


@dataclass(frozen=True)
class Cost:
    """CPU milliseconds a frame."""

    variant: str
    median_ms: float
    p95_ms: float
    min_ms: float


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The benchmark's own arguments."""
    parser.add_argument("--frames", type=int, default=100, help="frames of each variant (100)")
    parser.add_argument("--seed", type=int, default=7, help="of the scene (7, the demo's)")
    parser.add_argument("--size", default="1280x720", metavar="WxH", type=_size, help="of the picture (1280x720)")
    parser.add_argument(
        "--rig",
        type=Path,
        default=argparse.SUPPRESS,
        metavar="FILE",
        help="whose boxes (./rig.yaml, if there is one, else the demo's)",
    )


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    cv2.setNumThreads(1)
    width, height = args.size
    rig_file = args.rig or DEMO
    rig = load_rig(rig_file)
    scene = Scene(rig.boxes, family(rig.config.markers.family, rig.folder), args.seed)
    focal = FOCAL_PER_WIDTH * width
    matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    began = time.process_time()
    camera = SceneCamera(scene, CameraModel(width, height, matrix, np.zeros(5)))
    opening_s = time.process_time() - began
    costs = measure(variants(camera), max(args.frames, 2))
    if args.json:
        document = {"cv2": cv2.__version__, "size": [width, height], "rig": str(rig_file), "seed": args.seed}
        print(json.dumps(document | {"opening_s": opening_s, "variants": [asdict(cost) for cost in costs]}))
        return EXIT_OK
    console = Console(highlight=False)
    base = costs[0].median_ms
    rows = [
        [c.variant, f"{c.median_ms:.1f}", f"{c.p95_ms:.1f}", f"{c.min_ms:.1f}", f"{c.median_ms / base:.2f}"]
        for c in costs
    ]
    print_table(console, f"Rendering {width}x{height}, {len(rig.boxes)} boxes, cv2 {cv2.__version__}", _COLUMNS, rows)
    console.print(f"Opening the camera: {opening_s:.2f} s of CPU time", style="dim")
    return EXIT_OK


def variants(camera: SceneCamera) -> dict[str, Render]:
    """What is rendered, by name; the first is what the synthetic driver gives."""
    return {
        "colour and depth": camera.render,
        "colour alone": lambda index: camera.render(index, depth=False),
        "without noise and blur": lambda index: camera.render(index, noise=0, blur_px=0, depth_noise_mm=0),
        "without markers": lambda index: camera.render(index, markers=False),
    }


def measure(renders: dict[str, Render], frames: int) -> list[Cost]:
    """Render ``frames`` frames of the path in each variant, in turn.

    All of them are rendered once before that: a face's picture is drawn when the face is first seen.
    """
    for number in range(frames):
        next(iter(renders.values()))(number * STEP)
    spent: dict[str, list[float]] = {name: [] for name in renders}
    for number in range(frames):
        for name, render in renders.items():
            began = time.process_time()
            render(number * STEP)
            spent[name].append((time.process_time() - began) * 1e3)
    return [Cost(name, statistics.median(ms), float(np.percentile(ms, 95)), min(ms)) for name, ms in spent.items()]


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) >= 16 and int(height) >= 16):
        raise argparse.ArgumentTypeError(f"'{text}' is no size such as 1280x720")
    return int(width), int(height)
