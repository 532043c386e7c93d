"""`tagmill check`: what it prints and how it exits."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from common.bus import create_keys
from common.config.models import DRIVER_OPTIONS
from common.errors import EXIT_BAD_CONFIG, EXIT_OK
from tests.support.mounts import make_read_only, small_disk
from tools.check import UNCALIBRATED
from tools.cli import main

EXAMPLES = Path(__file__).resolve().parents[3] / "deploy" / "examples"


def test_a_good_rig_is_summed_up(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(EXAMPLES / "synthetic.yaml")]) == EXIT_OK
    out = capsys.readouterr().out
    first, *rest = out.splitlines()
    assert first.endswith("is good: 2 objects, 18 markers, 1 camera, family apriltag_36h11")
    assert "    front: markers 0 (50 mm, takes 6.0%), 1 (50 mm, takes 6.0%)" in rest
    assert "  camera cam0: synthetic, 1280 x 720, 30 frames/s, its own intrinsics" in rest
    assert rest[-1].startswith("  samples go to ")
    assert rest[-1].endswith("/dataset/synthetic")
    assert "warning" not in out


def test_guessed_intrinsics_are_called_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text("cameras: {depth: {driver: realsense}, desk: {driver: webcam, width: 640, height: 480}}\n")
    assert main(["check", str(path)]) == EXIT_OK
    out = capsys.readouterr().out
    assert "  camera depth: realsense, its own size, the factory's intrinsics\n" in out
    assert "  camera desk: webcam, 640 x 480, no calibration: its intrinsics are guessed, and so are distances\n" in out


def test_every_driver_says_what_is_known_without_a_calibration() -> None:
    assert UNCALIBRATED.keys() == DRIVER_OPTIONS.keys()


def test_a_dataset_that_cannot_be_written_is_warned_about(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text("dataset: {root: ./disk/dataset}\ncameras: {cam0: {driver: synthetic}}\n")
    with small_disk(tmp_path / "disk", 1) as disk:
        assert main(["check", str(path)]) == EXIT_OK
        assert "can't be written" not in capsys.readouterr().out
        make_read_only(disk)
        assert main(["check", str(path)]) == EXIT_OK
        assert f"warning: {disk} can't be written, so samples in {disk}/dataset will be" in capsys.readouterr().out


def test_the_share_counts_border_and_margin_and_warns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """50 mm + 2 x 10 mm border + 2 x 15 % of 50 mm = 85 mm; of a 170 mm square that is a quarter."""
    path = tmp_path / "rig.yaml"
    side = "front: {marker: 0, marker_size_mm: 50, border_mm: 10}"
    size = "{width: 170, height: 170, depth: 2}"
    path.write_text(f"objects: [{{name: plate, size_mm: {size}, sides: {{{side}}}}}]\n")
    assert main(["check", "--rig", str(path)]) == EXIT_OK
    out = capsys.readouterr().out
    assert "marker 0 (50 mm, takes 25.0%)" in out
    assert "warning: object plate, side front: erasing marker 0 takes 25% of the side" in out

    assert main(["check", str(path), "--json"]) == EXIT_OK
    document = json.loads(capsys.readouterr().out)
    assert document["ok"] is True
    assert document["markers"] == [{"object": "plate", "side": "front", "marker": 0, "covers": 0.25}]
    assert len(document["warnings"]) == 1


def test_no_objects_is_only_a_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text("cameras: {}\n")
    assert main(["check", str(path)]) == EXIT_OK
    assert "objects: there are none" in capsys.readouterr().out


def test_keys_that_control_would_refuse_are_a_mistake(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text("network: {command: 'tcp://127.0.0.1:5750', keys: keys}\n")
    (tmp_path / "keys").mkdir()
    assert main(["check", str(path)]) == EXIT_BAD_CONFIG
    assert "network.keys: no usable key in" in capsys.readouterr().out
    (tmp_path / "keys").rmdir()
    create_keys(tmp_path / "keys")
    assert main(["check", str(path)]) == EXIT_OK
    (tmp_path / "keys" / "server.key_secret").chmod(0o644)
    assert main(["up", "--rig", str(path)]) == EXIT_BAD_CONFIG
    assert "server.key_secret can be read by others; run: chmod 600" in capsys.readouterr().out


def test_mistakes_fit_on_one_screen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text("cameras:\n" + "".join(f"  cam{n}: {{driver: nobody}}\n" for n in range(30)))
    assert main(["check", str(path)]) == EXIT_BAD_CONFIG
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{path} can't be used, 30 mistakes:"
    assert lines[1].startswith(f"  {path}:2: cameras.cam0.driver: there is no driver 'nobody'")
    assert lines[-1] == "  and 10 more"
    assert len(lines) == 22

    assert main(["check", str(path), "--json"]) == EXIT_BAD_CONFIG
    document = json.loads(capsys.readouterr().out)
    assert document["ok"] is False
    assert len(document["problems"]) == 30


def test_missing_pictures_are_a_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(EXAMPLES / "video.yaml")]) == EXIT_BAD_CONFIG
    out = capsys.readouterr().out
    assert "1 mistake:" in out
    assert "cameras.cam0.path: there is nothing at" in out


def test_no_rig_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["check"]) == EXIT_BAD_CONFIG
    assert "--rig FILE" in capsys.readouterr().err
