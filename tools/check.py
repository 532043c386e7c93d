"""`tagmill check`: say all mistakes of a rig file at once, or what the rig holds."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.bus.keys import authorized_keys, server_pair
from common.config import Rig, load_rig
from common.errors import EXIT_OK, ConfigError
from common.geometry import Box, BoxSide, MarkerOnSide

SCREEN_LINES = 20
MUCH = 0.15
"""Above this share of a side, what is erased may be the very feature by which the side is recognised."""
_OF_A_PACKAGE = "no calibration: what its driver knows of it"
_GUESSED = "no calibration: its intrinsics are guessed, and so are distances"
UNCALIBRATED = {
    "synthetic": "its own intrinsics",
    "realsense": "the factory's intrinsics",
    "kinect2": "the factory's intrinsics",
    "files": "no calibration: the recording's intrinsics if it has any, else guessed ones",
    "webcam": _GUESSED,
    "stream": _GUESSED,
}
"""What is known of a camera without calibration, by its driver."""


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The sub-command's own arguments."""
    parser.add_argument("file", nargs="?", type=Path, help="the rig file (instead of --rig)")


def run(args: argparse.Namespace) -> int:
    """Check the rig file; exit code 0, or 78 if it has mistakes."""
    path = chosen_rig(args.file or args.rig)
    try:
        rig = checked_rig(path)
    except ConfigError as error:
        show_mistakes(path, error, as_json=args.json)
        return error.exit_code
    shares = covered_shares(rig)
    warnings = [*rig.warnings, *(share.warning for share in shares if share.part > MUCH)]
    if args.json:
        print(json.dumps(_document(rig, shares, warnings)))
    else:
        print("\n".join([*_summary(rig, shares), *(f"warning: {text}" for text in warnings)]))
    return EXIT_OK


def chosen_rig(path: Path | None) -> Path:
    """The rig file that was named; raises ConfigError that says how to name one."""
    if path is None:
        raise ConfigError("no rig file is named and there is no ./rig.yaml; name one with --rig FILE")
    return path


def checked_rig(path: Path) -> Rig:
    """The rig, with the files that it names: what it needs to run is there. Raises ConfigError."""
    rig = load_rig(path, inputs=True)
    keys = rig.config.network.keys
    if keys is not None:
        folder = rig.resolve(keys)
        try:
            server_pair(folder)
            authorized_keys(folder)
        except ConfigError as error:
            raise ConfigError(f"{path}: network.keys: {error.message}") from error
    return rig


def show_mistakes(path: Path, error: ConfigError, *, as_json: bool = False) -> None:
    """All mistakes, as many as fit on a screen."""
    if as_json:
        print(json.dumps({"ok": False, "rig": str(path), "problems": list(error.problems)}))
        return
    problems = error.problems
    count = "1 mistake" if len(problems) == 1 else f"{len(problems)} mistakes"
    print(f"{path} can't be used, {count}:")
    print("\n".join(f"  {problem}" for problem in problems[:SCREEN_LINES]))
    if len(problems) > SCREEN_LINES:
        print(f"  and {len(problems) - SCREEN_LINES} more")


@dataclass(frozen=True, slots=True)
class CoveredShare:
    """How much of a side is erased for one marker: its square with border and inpainting margin."""

    object: str
    side: str
    marker: int
    size_mm: float
    part: float

    @property
    def warning(self) -> str:
        """What to do about a marker that covers much of its side."""
        return (
            f"object {self.object}, side {self.side}: erasing marker {self.marker} takes {self.part:.0%} of the side; "
            "a smaller marker, or a place away from the side's features, keeps more of what a class is known by"
        )


def covered_shares(rig: Rig) -> tuple[CoveredShare, ...]:
    """The share of its side that each marker takes once it is erased."""
    margin = rig.config.inpaint.margin
    return tuple(
        CoveredShare(box.name, side.class_name, marker.id, marker.size_mm, _covered(box, side, marker, margin))
        for box in rig.boxes
        for side, marker in box.markers()
    )


def _covered(box: Box, side: BoxSide, marker: MarkerOnSide, margin: float) -> float:
    width, height, _ = box.face_size(side.face)
    edge = marker.size_mm + 2 * (marker.border_mm + margin * marker.size_mm)
    return min(1.0, edge * edge / (width * height))


def _summary(rig: Rig, shares: tuple[CoveredShare, ...]) -> list[str]:
    config = rig.config
    cameras = config.cameras
    what = (_count(len(rig.boxes), "object"), _count(len(shares), "marker"), _count(len(cameras), "camera"))
    lines = [f"{rig.path} is good: {', '.join(what)}, family {config.markers.family}"]
    for box in rig.boxes:
        size = " x ".join(f"{value:g}" for value in box.size_mm)
        lines.append(f"  {box.name} ({box.type}), {size} mm (width x height x depth)")
        for side in box.sides:
            own = [share for share in shares if share.object == box.name and share.side == side.class_name]
            markers = ", ".join(f"{one.marker} ({one.size_mm:g} mm, takes {one.part:.1%})" for one in own)
            face = "" if side.class_name == side.face else f" on the {side.face} face"
            lines.append(f"    {side.class_name}{face}: {'marker' if len(own) == 1 else 'markers'} {markers}")
    for name, camera in cameras.items():
        size = f"{camera.width} x {camera.height}" if camera.width and camera.height else "its own size"
        rate = f", {camera.fps:g} frames/s" if camera.fps else ""
        known = (
            f"calibrated by {camera.calibration}"
            if camera.calibration
            else UNCALIBRATED.get(camera.driver, _OF_A_PACKAGE)
        )
        lines.append(f"  camera {name}: {camera.driver}, {size}{rate}, {known}")
    lines.append(f"  samples go to {rig.dataset_root / config.dataset.session}")
    return lines


def _document(rig: Rig, shares: tuple[CoveredShare, ...], warnings: list[str]) -> dict[str, Any]:
    markers = [
        {"object": one.object, "side": one.side, "marker": one.marker, "covers": round(one.part, 4)} for one in shares
    ]
    return {
        "ok": True,
        "rig": str(rig.path),
        "fingerprint": rig.fingerprint,
        "warnings": warnings,
        "markers": markers,
        "content": rig.as_plain(),
        "samples": str(rig.dataset_root / rig.config.dataset.session),
    }


def _count(number: int, word: str) -> str:
    return f"{number} {word}" if number == 1 else f"{number} {word}s"
