"""`tagmill evaluate inpaint` on a few frames: its figures, its promises, its sheet."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from services.label.inpaint import METHODS
from tools.cli import main
from tools.evaluate.likeness import likenesses


@pytest.fixture(scope="module")
def document(tmp_path_factory):
    out = tmp_path_factory.mktemp("inpaint")
    assert main(["evaluate", "inpaint", "--frames", "6", "--seed", "2", "--json", "--out", str(out)]) == 0
    return json.loads((out / "inpaint.json").read_text()) | {"sheet": cv2.imread(str(out / "inpaint.png"))}


@pytest.mark.long
def test_no_marker_pixel_lies_outside_of_the_mask(document):
    assert document["frames"] == {"plain": 3, "covered": 1, "blurred": 1, "outside": 1}
    assert document["visible_markers_undetected"] >= 2  # the covered one, the blurred one
    assert document["marker_pixels"] > 50_000
    assert document["marker_pixels_outside_mask"] == 0


@pytest.mark.long
def test_no_detector_finds_an_erased_marker(document):
    assert min(document["found_before"].values()) > 10
    assert [sum(row["found"].values()) for row in document["methods"]] == [0] * len(METHODS)


@pytest.mark.long
def test_the_default_is_nearer_to_the_truth_than_the_rest(document):
    by_method = {row["method"]: row for row in document["methods"]}
    for rival in ("telea", "ns"):
        assert by_method["plane"]["psnr_db"] > by_method[rival]["psnr_db"] + 2
        assert by_method["smooth"]["ssim"] > by_method[rival]["ssim"]
    assert by_method["plane"]["grain"] == pytest.approx(1.0, abs=0.15)


@pytest.mark.long
def test_the_sheet_shows_every_method(document):
    assert document["sheet"].shape[1] > 200 * (len(METHODS) + 2)


def test_likeness_is_that_of_the_definition():
    random = np.random.default_rng(1)
    truth = cv2.GaussianBlur(random.integers(0, 255, (80, 80, 3), dtype=np.uint8), (0, 0), 1.0)
    region = np.zeros((80, 80), bool)
    region[20:60, 20:60] = True
    same = likenesses(truth, truth, [region])[0]
    assert (same.squared_error, round(same.ssim, 6), same.grain, same.pixels) == (0.0, 1.0, 1.0, 1600)
    other = truth.copy()
    other[region] = np.clip(truth[region].astype(int) + 5, 0, 255)
    away = likenesses(other, truth, [region])[0]
    assert away.psnr == pytest.approx(10 * np.log10(255**2 / 25), abs=0.2)
    assert away.ssim < 1.0
