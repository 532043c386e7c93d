"""The judge's look at a session's files: whole, nothing torn or left over, no picture with another frame's label."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[Any]

_LABEL = re.compile(r"label_(.+)\.json")
_SQUARE, _BITS, _TOP, _LEFT = 8, 32, 8, 8
"""The burnt strip: 32 squares, the highest bit first, white = 1; described in common/scene/burnt.py."""
_ERASED_MARGIN_PX = 6
_SAME_PX = 0.25
_BESIDE_LABELS = {"session.json", "records.jsonl"}


@dataclass(frozen=True)
class Sample:
    """What later checks need of a sample."""

    recording: str | None
    camera: str
    captured_ns: int
    whole: bool


def check_folder(session: Path, truth: dict[str, Any], violations: list[str], *, abandoned: bool) -> dict[str, Sample]:
    """Every sample of a session; adds a sentence for each fault found.

    ``abandoned``: the folder was taken away from under the store, so it may hold pictures whose label never came.
    """
    found: dict[str, Sample] = {}
    expected = set(_BESIDE_LABELS)
    for path in sorted((session / "label").glob("*")):
        name = _LABEL.fullmatch(path.name)
        if name is None:
            continue
        expected.add(f"label/{path.name}")
        label = None
        try:
            label = json.loads(path.read_text())
            expected |= {one["path"] for one in label["files"].values() if one is not None}
            wrong = _faults(session, label, name[1], truth)
        except (OSError, ValueError, KeyError, TypeError) as error:
            wrong = [f"can't be read: {error!r}"]
        violations += [f"{session.name}/{name[1]}: {one}" for one in wrong]
        if label is not None:
            found[name[1]] = Sample(
                label["recording"], label["camera"]["name"], label["captured_mono_ns"], whole=not wrong
            )
    if not abandoned:
        files = {str(path.relative_to(session)) for path in session.rglob("*") if path.is_file()}
        violations += [f"{session.name}: {stray} belongs to no sample" for stray in sorted(files - expected)]
    return found


def _faults(session: Path, label: dict[str, Any], name: str, truth: dict[str, Any]) -> list[str]:
    """What is wrong with one sample."""
    if label["sample"] != name:
        return [f"its label says {label['sample']}"]
    pictures: dict[str, Picture] = {}
    for kind in ("rgb", "depth", "original"):
        stored = label["files"][kind]
        if stored is None:
            return [f"has no {kind} picture"]
        data = (session / stored["path"]).read_bytes()
        if len(data) != stored["size"] or hashlib.sha256(data).hexdigest() != stored["sha256"]:
            return [f"{stored['path']} is torn: not the size and checksum in its label"]
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if picture is None:
            return [f"{stored['path']} is no picture"]
        pictures[kind] = picture
    return _pairing(label, pictures, truth[label["camera"]["name"]])


def _pairing(label: dict[str, Any], pictures: dict[str, Picture], camera: dict[str, Any]) -> list[str]:
    """Whether pictures, depth and label are all of one frame: that which the camera's clock names."""
    frame = round(label["device_ns"] * camera["fps"] / 1e9)
    steps, strip = camera["steps"], camera["strip_px"]
    wanted = steps[frame % len(steps)]
    wrong = []
    for kind in ("rgb", "original"):
        burnt = _burnt_number(pictures[kind])
        if burnt != frame:
            wrong.append(f"its {kind} picture is of frame {burnt}, its label of {frame}")
    if _checksum(pictures["original"][strip:]) != wanted["picture"]:
        wrong.append(f"its original is not wholly frame {frame} as the camera gave it")
    if _checksum(pictures["depth"]) != wanted["depth"]:
        wrong.append(f"its depth is not wholly that of frame {frame}")
    if not _same_but_erased(pictures["rgb"], pictures["original"], label["inpainted"]["polygons"]):
        wrong.append("its rgb picture differs from the original outside of what was erased")
    away = [_distance_px(label, step["markers"]) for step in steps]
    # The camera goes there and back: two frames of a round may show the same.
    if away[frame % len(steps)] > min(away) + _SAME_PX:
        wrong.append(f"its markers are where step {int(np.argmin(away))} has them, not step {frame % len(steps)}")
    return wrong


def _distance_px(label: dict[str, Any], markers: dict[str, Any]) -> float:
    """How far the label's marker corners are from those of a step of the path: the median, one corner may be off."""
    found = [(side["marker"], side["marker_corners"]) for thing in label["objects"] for side in thing["sides"]]
    found += [(one["marker"], one["corners"]) for one in label["left_out"] if one["corners"] is not None]
    away = [
        float(np.linalg.norm(np.subtract(here, there)))
        for marker, corners in found
        for here, there in zip(corners, markers[str(marker)], strict=True)
    ]
    return float(np.median(away)) if away else 0.0


def _burnt_number(bgr: Picture) -> int | None:
    strip = bgr[_TOP : _TOP + _SQUARE, _LEFT : _LEFT + _BITS * _SQUARE].astype(float).mean(axis=2)
    levels = [strip[2:-2, bit * _SQUARE + 2 : (bit + 1) * _SQUARE - 2].mean() for bit in range(_BITS)]
    if any(64 < level < 192 for level in levels):
        return None
    return sum(int(level > 128) << (_BITS - 1 - bit) for bit, level in enumerate(levels))


def _same_but_erased(rgb: Picture, original: Picture, polygons: list[dict[str, Any]]) -> bool:
    erased = np.zeros(rgb.shape[:2], np.uint8)
    for one in polygons:
        outline = np.round(np.array(one["polygon"])).astype(np.int32)
        cv2.fillPoly(erased, [outline], 255)
    around = cv2.dilate(erased, np.ones((2 * _ERASED_MARGIN_PX + 1,) * 2, np.uint8))
    differ = (rgb != original).any(axis=2)
    return not bool((differ & (around == 0)).any())


def _checksum(picture: Picture) -> str:
    return hashlib.sha256(np.ascontiguousarray(picture).tobytes()).hexdigest()
