"""What an operator does: a rig with a camera that plays the frames, the stack, one recording, one export."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from common.bus import CommandClient, Endpoints
from common.config import load_rig
from common.dataset import SessionReader
from common.errors import DatasetError, TagmillError
from tools.proof.scenes import BARE, CAMERA, DEPTH, HEIGHT, MARKED, RIG, WIDTH
from tools.stack.running import running_stack, wait_ready

_READY_S = 180.0
CAMERA_NAME = "cam0"
_LIMIT_S = 1800.0
VARIANTS = ("marker-free", "erased", "raw")
"""What the detectors are trained on: the same frames and labels, other pictures."""


@dataclass(frozen=True)
class Recorded:
    """The session that the stack wrote, and what became of the frames that were played."""

    session: SessionReader
    ledger: dict[str, Any]


def record(frames: Path, out: Path) -> Recorded:
    """Play the marked pictures to the real stack as a camera's, and record all of them.

    Raises TagmillError if the stack doesn't come up or a command is refused; its log is ``out/stack.log``.
    """
    rig = _write_rig(frames, out)
    with tempfile.TemporaryDirectory(prefix="tagmill-proof-") as run:
        os.environ["TAGMILL_RUN_DIR"] = run
        os.environ["TAGMILL_PREFIX"] = f"proof-{os.getpid()}"
        with running_stack(rig, out / "stack.log"):
            client = CommandClient(Endpoints.of(load_rig(rig).config.network), timeout_s=5.0)
            try:
                wait_ready(client, {CAMERA_NAME}, _READY_S)
            finally:
                client.close()
            ledger = tagmill_json("start", "--camera", "all", "--wait", "--rig", str(rig))["ledger"]
    return Recorded(SessionReader(out / "dataset" / "proof"), ledger)


def _write_rig(frames: Path, out: Path) -> Path:
    calibration = {
        "width": WIDTH,
        "height": HEIGHT,
        "camera_matrix": CAMERA.matrix.tolist(),
        "distortion": CAMERA.distortion.tolist(),
    }
    (out / "camera.yaml").write_text(yaml.safe_dump(calibration, sort_keys=False))
    rig = yaml.safe_load(RIG.read_text(encoding="utf-8"))
    rig["cameras"] = {
        CAMERA_NAME: {
            "driver": "files",
            "path": str(frames / MARKED),
            "depth_path": str(frames / DEPTH),
            "calibration": "camera.yaml",
            "pace": "consumer",
        }
    }
    path = out / "rig.yaml"
    path.write_text(yaml.safe_dump(rig, sort_keys=False))
    return path


def export(recorded: Recorded, frames: Path, out: Path) -> dict[str, Path]:
    """The session as YOLO sets, by `tagmill export yolo --classes side`; ``data.yaml`` of each of VARIANTS.

    ``erased`` is the export as it is. The others are the same files with other pictures under the same names: for
    ``raw`` the originals that the session keeps, for ``marker-free`` the frames rendered without markers.
    """
    session = recorded.session
    erased = out / "erased"
    command = ("export", "yolo", str(session.folder), "--classes", "side", "--split", "none")
    told = tagmill_json(*command, "--out", str(erased))
    if not told["ok"]:
        raise DatasetError(f"the export failed its checks: {told['checks']['wrong']}")
    for variant in (name for name in VARIANTS if name != "erased"):
        shutil.copytree(erased, out / variant, copy_function=os.link)
    for picture in sorted(erased.glob("images/*/*.png")):
        label, place = session.label(picture.stem), picture.relative_to(erased)
        assert label.files is not None
        assert label.files.original is not None
        assert label.source_name is not None
        _replace(out / "raw" / place, session.folder / label.files.original.path)
        _replace(out / "marker-free" / place, frames / BARE / Path(label.source_name).name)
    return {variant: out / variant / "data.yaml" for variant in VARIANTS}


def _replace(path: Path, picture: Path) -> None:
    path.unlink()
    path.hardlink_to(picture)


def tagmill_json(*arguments: str) -> dict[str, Any]:
    """The document that a `tagmill ... --json` prints; raises TagmillError with what it says if it fails."""
    command = [sys.executable, "-m", "tools", *arguments, "--json"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise TagmillError(f"tagmill {arguments[0]} did not end in {_LIMIT_S:g} s: is the machine too busy?") from error
    if done.returncode != 0:
        raise TagmillError(f"tagmill {arguments[0]} failed: {done.stdout.strip()} {done.stderr.strip()}")
    found: dict[str, Any] = json.loads(done.stdout)
    return found
