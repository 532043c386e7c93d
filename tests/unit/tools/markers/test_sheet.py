"""`tagmill markers sheet`: the page is rendered by another program and measured like a scanned print."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from common.config import load_rig
from common.errors import EXIT_OK, EXIT_REFUSED
from common.geometry import FACES
from common.markers import family
from tests.support.printed import MM, need_poppler, rendered, runs, to_mm, words
from tools.cli import main
from tools.markers.label import arrow, rig_markers, up_direction
from tools.markers.pages import Sheet, lay_out
from tools.markers.paper import Paper, parse_paper

RIG = """
markers: {family: FAMILY}
objects:
  - name: box-1
    size_mm: {width: 400, height: 300, depth: 300}
    sides:
      front: {marker: 0, marker_size_mm: 50, border_mm: 10}
      left: {marker: 1, marker_size_mm: 80, border_mm: 12, offset_mm: [20, -35]}
      lid: {face: top, markers: [{marker: 2, marker_size_mm: 15, border_mm: 3, offset_mm: [-80, 0], rotation_deg: 30},
                                 {marker: 9, marker_size_mm: 25, border_mm: 5, rotation_deg: 90}]}
  - name: a-plate-whose-name-is-as-long-as-a-name-can-possibly-be-in-rigs
    size_mm: {width: 120, height: 120, depth: 3}
    sides:
      the-side-with-the-lettering-and-the-logo-of-whoever-made-it:
        {face: front, marker: 12, marker_size_mm: 60, border_mm: 20}
      back: {marker: 3, marker_size_mm: 33.3}
"""
PAPERS = ("A4", "Letter", "A3")


def rig_file(folder: Path, name: str = "apriltag_36h11", text: str = RIG) -> Path:
    path = folder / "rig.yaml"
    path.write_text(text.replace("FAMILY", name))
    return path


def laid_out(path: Path, paper: str) -> Sheet:
    return lay_out(rig_markers(load_rig(path)), parse_paper(paper))


def detected(page: NDArray[np.uint8], name: str, dpi: int) -> dict[int, NDArray[np.float64]]:
    """Marker corners (4, 2) TL TR BR BL in the marker's own frame, mm on the page."""
    markers = family(name, Path())
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.minMarkerPerimeterRate = 0.01
    found, ids, _ = cv2.aruco.ArucoDetector(markers.dictionary, parameters).detectMarkers(page)
    assert ids is not None
    order = list(markers.own_order)
    return {
        int(marker): to_mm(corners.reshape(4, 2)[order].astype(float), dpi)
        for marker, corners in zip(ids.ravel(), found, strict=True)
    }


@pytest.mark.parametrize(
    ("paper", "dpi", "name"), [("A4", 600, "apriltag_36h11"), ("Letter", 300, "4x4_50"), ("A3", 300, "apriltag_25h9")]
)
def test_markers_are_printed_at_their_place_and_size(paper: str, dpi: int, name: str, tmp_path: Path) -> None:
    need_poppler()
    path, out = rig_file(tmp_path, name), tmp_path / "out.pdf"
    assert main(["markers", "sheet", str(path), "--paper", paper, "--out", str(out)]) == EXIT_OK
    sheet = laid_out(path, paper)
    pages = rendered(out, dpi)
    assert len(pages) == sheet.pages
    seen = 0
    for number, page in enumerate(pages):
        size = np.array(page.shape[::-1]) / dpi * MM
        assert np.allclose(size, [sheet.paper.width, sheet.paper.height], atol=MM / dpi)
        found = detected(page, name, dpi)
        for placed in (one for one in sheet.cells if one.page == number):
            one = placed.block.item.one
            corners = found.pop(one.marker.id)
            assert np.abs(corners - sheet.square(placed)).max() <= 0.1, "place"
            sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
            assert np.abs(sides - one.marker.size_mm).max() <= 0.1, "size"
            assert quiet(page, corners, min(one.cell_mm, one.marker.border_mm), dpi), "white around the black square"
            seen += 1
        # Text of a millimetre may happen to read as one of a small family's patterns.
        assert [marker for marker, corners in found.items() if np.ptp(corners) > 10] == [], "no other marker"
        assert_scale(page, dpi)
        assert_inside_what_printers_reach(page, dpi)
    assert seen == 6


def quiet(page: NDArray[np.uint8], corners: NDArray[np.float64], rim: float, dpi: int) -> bool:
    """Whether a ring of ``rim`` mm around the square (from 0.1 mm off it) is white."""
    if rim < 0.3:
        return True
    outer = [round(value / MM * dpi) for value in (*(corners[0] - rim + 0.1), *(corners[2] + rim - 0.1))]
    inner = [round(value / MM * dpi) for value in (*(corners[0] - 0.1), *(corners[2] + 0.1))]
    ring = page.copy()
    ring[inner[1] : inner[3], inner[0] : inner[2]] = 255
    return bool((ring[outer[1] : outer[3], outer[0] : outer[2]] == 255).all())


def assert_scale(page: NDArray[np.uint8], dpi: int) -> None:
    """The ruler's line is 100 mm long, and the caliper box 50 x 15 mm, in the page's lowest part."""
    foot = page[-round(36 / MM * dpi) :] < 128
    lengths = [(b - a) / dpi * MM for row in foot for a, b in runs(row)]
    assert min(abs(length - 100) for length in lengths) <= 0.1 + 0.14, "a mark's width beyond its ends"
    assert min(abs(length - 50) for length in lengths) <= 0.1
    heights = [(b - a) / dpi * MM for column in foot.T for a, b in runs(column)]
    assert min(abs(height - 15) for height in heights) <= 0.1
    # The long marks 0 and 100: their centres, where the ruler's other marks do not reach.
    for row in foot:
        marks = [(a + b) / 2 / dpi * MM for a, b in runs(row) if (b - a) / dpi * MM < 0.4]
        if len(marks) >= 2 and abs(marks[1] - marks[0] - 100) <= 0.1:
            return
    pytest.fail("no two marks 100 mm apart")


def assert_inside_what_printers_reach(page: NDArray[np.uint8], dpi: int) -> None:
    ys, xs = np.nonzero(page < 250)
    left, top, right, bottom = (
        value / dpi * MM for value in (xs.min(), ys.min(), page.shape[1] - xs.max(), page.shape[0] - ys.max())
    )
    assert min(left, top, right) >= 6.4
    assert bottom >= 12.7


@pytest.mark.parametrize("paper", PAPERS)
def test_each_label_stands_at_its_marker(paper: str, tmp_path: Path) -> None:
    need_poppler()
    path, out = rig_file(tmp_path), tmp_path / "out.pdf"
    assert main(["markers", "sheet", str(path), "--paper", paper, "--out", str(out)]) == EXIT_OK
    sheet = laid_out(path, paper)
    told: list[int] = []
    for number, page in enumerate(words(out)):
        squares = {one.block.item.one.marker.id: sheet.square(one) for one in sheet.cells if one.page == number}
        for (word, x, y), (value, _, _) in pairwise(page):
            if word == "id":
                apart = {marker: distance(np.array([x, y]), corners) for marker, corners in squares.items()}
                assert min(apart, key=lambda marker: apart[marker]) == int(value)
                told.append(int(value))
    assert sorted(told) == [0, 1, 2, 3, 9, 12]


def distance(point: NDArray[np.float64], corners: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.maximum(0, np.maximum(corners[0] - point, point - corners[2]))))


def test_the_sheet_is_vectors_with_its_fonts_and_the_same_each_time(tmp_path: Path) -> None:
    path = rig_file(tmp_path)
    for name in ("a.pdf", "b.pdf"):
        assert main(["markers", "sheet", str(path), "--out", str(tmp_path / name)]) == EXIT_OK
    data = (tmp_path / "a.pdf").read_bytes()
    assert data == (tmp_path / "b.pdf").read_bytes()
    assert b"/Image" not in data.replace(b"/ImageC", b"").replace(b"/ImageB", b"").replace(b"/ImageI", b"")
    assert b"/FontFile2" in data
    assert b"/Helvetica" not in data
    assert b"/PrintScaling /None" in data


@pytest.mark.parametrize("rotation", [0.0, 30.0, 90.0, -45.0, 180.0])
@pytest.mark.parametrize("side", [0, 1, 2])
def test_the_arrow_points_up_once_the_marker_is_stuck_on(rotation: float, side: int, tmp_path: Path) -> None:
    """Through the very pose that labels use: paper to marker frame to object frame gives the side's up."""
    text = RIG.replace("rotation_deg: 30", f"rotation_deg: {rotation}")
    box = load_rig(rig_file(tmp_path, text=text)).boxes[0]
    at = box.sides[side]
    marker = at.markers[0]
    right, down = up_direction(marker.rotation_deg)
    found = box.marker_pose(at, marker).rotation @ np.array([right, -down, 0.0])
    assert np.allclose(found, FACES[at.face].up)
    drawn = arrow(np.zeros(2), marker.rotation_deg, 8.0)
    assert np.allclose(drawn[0], up_direction(marker.rotation_deg) * 4)


def test_what_the_sheet_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = rig_file(tmp_path)
    assert main(["markers", "sheet", str(path), "--out", str(tmp_path / "new" / "o.pdf")]) == EXIT_OK
    out = capsys.readouterr().out
    assert "6 markers on 2 pages of A4" in out
    assert "  box-1, front: marker 0, 50 mm, takes 6.0% of its side" in out
    assert out.count("warning: ") == 3, "1 and 12 take much; 3 has no border"
    assert "erasing marker 12 takes 97% of the side" in out
    assert "marker 3 has a border of 0 mm" in out
    assert "border_mm: 4.16" in out
    assert main(["markers", "sheet", str(path), "--out", str(tmp_path / "o.pdf"), "--json"]) == EXIT_OK
    document = json.loads(capsys.readouterr().out)
    assert (document["ok"], document["pages"], len(document["markers"])) == (True, 2, 6)


def test_a_marker_too_large_is_refused_with_a_paper_that_holds_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = rig_file(tmp_path, text=RIG.replace("marker_size_mm: 80", "marker_size_mm: 200"))
    for paper, cure in (("A4", "--paper A3 would hold it"), ("Letter", "--paper Tabloid would hold it")):
        out = tmp_path / f"{paper}.pdf"
        assert main(["markers", "sheet", str(path), "--paper", paper, "--out", str(out)]) == EXIT_REFUSED
        said = capsys.readouterr().err
        assert "marker 1 is 224 mm wide with its border" in said
        assert cure in said
        assert not out.exists()
    assert main(["markers", "sheet", str(path), "--paper", "a3", "--out", str(tmp_path / "o.pdf")]) == EXIT_OK


def test_the_measured_ruler_corrects_the_rig(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = rig_file(tmp_path)
    assert main(["markers", "sheet", str(path), "--measured", "98.7"]) == EXIT_OK
    out = capsys.readouterr().out
    assert "98.70% of true scale" in out
    assert "print again at 101.32%" in out
    assert "front: marker: 0, marker_size_mm: 49.35, border_mm: 9.87" in out
    assert list(tmp_path.glob("*.pdf")) == [], "no sheet is written"
    assert main(["markers", "sheet", str(path), "--measured", "98,7", "--json"]) == EXIT_OK
    document = json.loads(capsys.readouterr().out)
    assert document["scale"] == 0.987
    assert document["markers"][1] == {
        "object": "box-1", "side": "left", "marker": 1, "marker_size_mm": 78.96, "border_mm": 11.84,
    }  # fmt: skip
    assert main(["markers", "sheet", str(path), "--measured", "100.1"]) == EXIT_OK
    assert "nothing to correct" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("option", "value", "words_"),
    [
        ("--measured", "9.87", "looks like centimetres"),
        ("--measured", "wide", "is no length"),
        ("--paper", "A44", "is no paper"),
        ("--paper", "20x900", "each side must be"),
    ],
)
def test_a_wrong_option_says_what_is_right(
    option: str, value: str, words_: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["markers", "sheet", str(rig_file(tmp_path)), option, value])
    assert words_ in capsys.readouterr().err


def test_what_stands_in_the_way_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "taken").write_text("")
    path = rig_file(tmp_path)
    assert main(["markers", "sheet", str(path), "--out", str(tmp_path / "taken" / "o.pdf")]) == EXIT_REFUSED
    assert "can't be written" in capsys.readouterr().err
    bare = tmp_path / "bare.yaml"
    bare.write_text("cameras: {}\n")
    assert main(["markers", "sheet", str(bare)]) == EXIT_REFUSED
    assert "no object has a marker" in capsys.readouterr().err


def test_markers_are_printed_before_the_camera_is_calibrated(tmp_path: Path) -> None:
    text = RIG + "cameras: {cam0: {driver: webcam, calibration: calibration/not-yet.yaml}}\n"
    path = rig_file(tmp_path, text=text)
    assert main(["markers", "sheet", str(path), "--out", str(tmp_path / "o.pdf")]) == EXIT_OK


@pytest.mark.parametrize("name", ["apriltag_36h11", "5x5_100"])
def test_single_markers_as_png_and_svg(name: str, tmp_path: Path) -> None:
    path = rig_file(tmp_path, name)
    args = ["--out", str(tmp_path / "o.pdf"), "--png", str(tmp_path / "p"), "--svg", str(tmp_path / "s")]
    assert main(["markers", "sheet", str(path), *args]) == EXIT_OK
    for one in rig_markers(load_rig(path)):
        data = (tmp_path / "p" / f"{one.name}.png").read_bytes()
        at = data.index(b"pHYs") + 4
        per_mm = int.from_bytes(data[at : at + 4], "big") / 1000
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert picture is not None
        assert abs(picture.shape[1] / per_mm - one.edge_mm) <= 0.1
        ys, xs = np.nonzero(picture == 0)
        assert abs((xs.max() - xs.min() + 1) / per_mm - one.marker.size_mm) <= 0.02
        cell = (xs.max() - xs.min() + 1) / one.family.cells
        centres = (np.arange(one.family.cells) + 0.5) * cell
        shown = picture[np.ix_((ys.min() + centres).astype(int), (xs.min() + centres).astype(int))] // 255
        assert shown.tolist() == one.family.bitmap(one.marker.id).tolist(), "upright in its own frame"
        drawing = (tmp_path / "s" / f"{one.name}.svg").read_text()
        assert f'width="{one.edge_mm:g}mm"' in drawing
        assert 'fill-rule="evenodd"' in drawing


def test_papers_by_name_and_size() -> None:
    assert parse_paper("letter") == Paper("Letter", 215.9, 279.4)
    assert parse_paper("300 x 200") == Paper("300x200", 300, 200)
    assert parse_paper("300x200").upright == Paper("300x200", 200, 300)
