"""The detector benchmark's counting, its scenes, and its figures as JSON."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.markers import family
from tools.bench import detect, marker_scenes
from tools.bench.detect_cases import EMPTY, REFERENCE, SEARCHED, Case, TrueMarker
from tools.bench.detect_rivals import OURS, TARGET, contenders
from tools.bench.detect_table import trade_off

FAMILY = family(SEARCHED, Path())
SQUARE = np.array([[10.0, 10.0], [50.0, 10.0], [50.0, 50.0], [10.0, 50.0]])


def true(marker: int, shift: float = 0.0) -> TrueMarker:
    corners = SQUARE + shift
    return TrueMarker(marker, corners, corners.mean(axis=0))


def test_each_find_counts_once_and_wrong_ids_are_told_from_unlisted() -> None:
    case = Case("row", np.zeros((8, 8), np.uint8), FAMILY, (true(3), true(3, 100.0), true(5, 200.0)), rendered=True)
    score = detect.Score()
    detect.count([(3, SQUARE + 0.3), (3, SQUARE + 0.3), (9, SQUARE + 200.0)], case, score)
    assert (score.markers, score.found, score.unlisted, score.wrong) == (3, 1, 1, 1)
    assert score.errors_px == [pytest.approx(0.3 * np.sqrt(2))]


def test_there_are_24_reference_scenes_of_72_markers() -> None:
    scenes = list(marker_scenes.reference(FAMILY, 1))
    assert len(scenes) == 24
    assert sum(len(scene.markers) for scene in scenes) == 72
    assert all(scene.grey.shape == (720, 1280) for scene in scenes)


def test_a_seed_repeats_its_scenes() -> None:
    make = marker_scenes.ROWS["side 25-40 px"]
    one, same, other = (make(FAMILY, np.random.default_rng(seed)).grey for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_the_scenes_truth_is_where_an_independent_detector_sees_it() -> None:
    scene = next(marker_scenes.reference(FAMILY, 3))
    quads, ids, _ = cv2.aruco.ArucoDetector(FAMILY.dictionary).detectMarkers(scene.grey)
    seen = {
        int(i): np.asarray(q).reshape(4, 2)[list(FAMILY.own_order)] for i, q in zip(ids.ravel(), quads, strict=True)
    }
    assert set(seen) == {marker.id for marker in scene.markers}
    assert all(np.abs(seen[marker.id] - marker.corners).max() < 2.0 for marker in scene.markers)


def test_a_short_run_is_measured_and_written_as_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    scene = next(marker_scenes.reference(FAMILY, 1))
    markers = tuple(TrueMarker(m.id, m.corners, m.corners.mean(axis=0)) for m in scene.markers)
    cases = [Case(REFERENCE, scene.grey, FAMILY, markers, rendered=True)]
    empty = Case(EMPTY, next(marker_scenes.empty(1, 1)).grey, FAMILY, ())
    chosen = {name: search for name, search in contenders()[0].items() if name in (OURS, "cv2 SUBPIX")}
    monkeypatch.setattr(detect, "contenders", lambda: (chosen, ["locus"]))
    monkeypatch.setattr(detect, "rendered", lambda *_: iter(cases))
    monkeypatch.setattr(detect, "photographs", lambda _: ([], ["gone.jpg"]))
    monkeypatch.setattr(detect, "marker_free", lambda *_: iter([empty]))
    monkeypatch.setattr(detect, "track", lambda *_: [])
    for as_json, data in ((True, tmp_path), (False, None)):
        args = argparse.Namespace(data=data, seed=1, scenes=1, rounds=2, json=as_json)
        assert detect.run(args) == 0
        text = capsys.readouterr().out
        if as_json:
            told = json.loads(text)
            ours = told["detectors"][OURS]
            assert (ours[REFERENCE]["found"], ours[EMPTY]["wrong"]) == (3, 0)
            assert ours[REFERENCE]["corner_error_px"] < 0.15
            assert told["detectors"][detect.REFINED][REFERENCE]["corner_error_px"] < 0.05
            assert told["missing"] == ["gone.jpg"]
        else:
            assert "3/3" in text
            assert "0 in 1" in text
            assert f"not there: {detect.NO_PHOTOGRAPHS}" in text


def test_the_trade_off_has_a_point_for_each_detector_that_sees_all_difficulties() -> None:
    def score(found: int, ms: float) -> detect.Score:
        return detect.Score(pictures=1, markers=4, found=found, errors_px=[0.1] * found, times_ms=[[ms, ms]])

    def photos(found: int, ms: float) -> detect.Score:
        return detect.Score(pictures=1, markers=4, found=found, times_ms=[[ms, ms]])

    scores = {
        OURS: {REFERENCE: score(4, 1.0), "tilt": score(3, 1.0), "photos": photos(4, 3.0)},
        TARGET: {REFERENCE: score(2, 2.0), "tilt": score(1, 2.0), "photos": photos(3, 2.0)},
        detect.REFINED: {REFERENCE: score(4, 1.0)},
    }
    ours, target = trade_off(scores)
    assert ours == {
        "detector": OURS,
        "default": True,
        REFERENCE: 1.0,
        "difficult": 0.75,
        "photographs": 1.0,
        "ratios": {REFERENCE: 0.5, "photos": 1.5},
    }
    assert (target["default"], target["difficult"], target["ratios"]["photos"]) == (False, 0.25, 1.0)
