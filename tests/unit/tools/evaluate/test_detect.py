"""`tagmill evaluate detect` on a folder: what detectors confirm and miss of each other, and mistakes in the folder."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.errors import EXIT_BAD_CONFIG
from common.markers import family
from tools.bench import marker_scenes
from tools.bench.detect_cases import SEARCHED
from tools.cli import main
from tools.evaluate.detect import evaluate

FAMILY = family(SEARCHED, Path())
SQUARE = np.array([[10.0, 10.0], [50.0, 10.0], [50.0, 50.0], [10.0, 50.0]])


def test_settings_of_one_maker_are_no_witnesses_of_each_other() -> None:
    searches = {
        "a one": lambda *_: [(1, SQUARE)],
        "a two": lambda *_: [(1, SQUARE), (2, SQUARE + 100)],
        "b": lambda *_: [(2, SQUARE + 101)],
        "c": lambda *_: [(2, SQUARE + 99)],
        "d": lambda *_: None,
    }
    finds, ids = evaluate(iter([("x.png", np.zeros((8, 8), np.uint8))]), searches, FAMILY, frozenset({2}))
    counts = {name: (item.markers, item.confirmed, item.missed, item.unknown) for name, item in finds.items()}
    assert counts == {"a one": (1, 0, 1, 1), "a two": (2, 1, 0, 1), "b": (1, 1, 0, 0), "c": (1, 1, 0, 0)}
    assert ids == {"x.png": {"a one": [1], "a two": [1, 2], "b": [2], "c": [2]}}


def test_a_folder_of_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = next(marker_scenes.reference(FAMILY, 1))
    cv2.imwrite(str(tmp_path / "scene.png"), scene.grey)
    assert main(["evaluate", "detect", "--folder", str(tmp_path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["detectors"]["tagmill auto"]["markers"] == 3
    assert told["detectors"]["tagmill auto"]["confirmed"] == 3
    assert told["pictures"]["scene.png"]["tagmill auto"] == sorted(marker.id for marker in scene.markers)
    assert main(["evaluate", "detect", "--folder", str(tmp_path)]) == 0
    assert "tagmill auto" in capsys.readouterr().out


def test_what_can_be_wrong_with_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "detect", "--folder", str(tmp_path / "gone")]) == EXIT_BAD_CONFIG
    assert "there is no folder" in capsys.readouterr().err
    assert main(["evaluate", "detect", "--folder", str(tmp_path)]) == EXIT_BAD_CONFIG
    assert "there are no pictures" in capsys.readouterr().err
    (tmp_path / "broken.png").write_bytes(b"no picture")
    assert main(["evaluate", "detect", "--folder", str(tmp_path)]) == EXIT_BAD_CONFIG
    assert "can't be read" in capsys.readouterr().err
