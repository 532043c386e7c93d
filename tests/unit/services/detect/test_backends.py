"""Every backend speaks one convention: corners in the marker's own order, a pixel's centre integer."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from common.errors import ConfigError
from common.markers import family
from services.detect.markers import open_detector
from services.detect.markers.locus import FAMILIES
from tests.support.rendered_marker import drawing, looking_at, render

HERE = Path()
PACKAGES = {"apriltag": "pupil_apriltags", "locus": "locus"}


def installed(detector: str) -> None:
    if importlib.util.find_spec(PACKAGES.get(detector, "cv2")) is None:
        pytest.skip(f"the optional package of '{detector}' isn't installed")


@pytest.mark.parametrize("detector", ["auto", "opencv", "apriltag", "locus"])
def test_corners_are_the_markers_own(detector: str) -> None:
    installed(detector)
    rng = np.random.default_rng(5)
    opened = open_detector("apriltag_36h11", HERE, detector=detector)
    off = []
    for marker in range(6):
        seen = render(drawing("DICT_APRILTAG_36h11", marker), 50, looking_at(rng, 400, 30), rng)
        (found,) = opened.detect(seen.grey)
        assert found.id == marker
        off.append(np.array(found.corners) - seen.corners)
    assert np.abs(off).max() < 1.2
    # Half a pixel that was forgotten would stay in the mean.
    assert np.abs(np.mean(off, axis=(0, 1))).max() < 0.12


@pytest.mark.parametrize("name", [name for name in FAMILIES if not name.startswith("apriltag")])
def test_aruco_families_of_locus_are_not_turned(name: str) -> None:
    installed("locus")
    rng = np.random.default_rng(6)
    known = "DICT_ARUCO_MIP_36h12" if "mip" in name else f"DICT_{name.upper()}"
    seen = render(drawing(known, 4), 50, looking_at(rng, 350, 20), rng)
    (found,) = open_detector(name, HERE, detector="locus").detect(seen.grey)
    assert found.id == 4
    assert np.abs(np.array(found.corners) - seen.corners).max() < 1.2


@pytest.mark.parametrize("detector", ["apriltag", "locus"])
def test_a_family_that_a_detector_lacks_is_named_with_the_cure(detector: str) -> None:
    with pytest.raises(ConfigError, match=r"not 5x5_1000; set markers\.detector to auto"):
        open_detector("5x5_1000", HERE, detector=detector)


@pytest.mark.parametrize("detector", ["apriltag", "locus"])
def test_a_missing_package_is_named_with_the_cure(detector: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, PACKAGES[detector], None)
    with pytest.raises(ConfigError, match=rf"pip install 'tagmill\[{detector}\]'"):
        open_detector(family("apriltag_36h11", HERE), HERE, detector=detector)


def test_a_process_that_used_the_apriltag_library_ends_well() -> None:
    installed("apriltag")
    code = (
        "from pathlib import Path; import numpy as np\n"
        "from services.detect.markers import open_detector\n"
        "detectors = [open_detector('tag36h11', Path(), detector='apriltag') for _ in range(3)]\n"
        "assert [d.detect(np.zeros((64, 64), np.uint8)) for d in detectors] == [[], [], []]\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_the_apriltag_library_serves_one_family_a_process() -> None:
    installed("apriltag")
    open_detector("apriltag_36h11", HERE, detector="apriltag")
    with pytest.raises(ConfigError, match="searches for tag36h11 in this process"):
        open_detector("apriltag_25h9", HERE, detector="apriltag")
