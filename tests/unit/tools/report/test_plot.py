from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import pytest

from tools.report.page import Page
from tools.report.plot import Axis, Series, plot, ticks

SVG = "{http://www.w3.org/2000/svg}"


def drawn(*series: Series, y: Axis | None = None) -> ET.Element:
    return ET.fromstring(plot("a <title>", Axis("x, mm"), y or Axis("y, mm"), series))


def test_points_lie_where_their_values_are():
    root = drawn(Series("one", [0, 5, 10], [1.0, 2.0, 3.0]))
    x, y = zip(*((float(c.get("cx")), float(c.get("cy"))) for c in root.iter(SVG + "circle")), strict=True)
    assert x[1] - x[0] == pytest.approx(x[2] - x[1], abs=0.11)
    assert y[0] > y[1] > y[2]
    assert y[0] - y[1] == pytest.approx(y[1] - y[2], abs=0.11)


def test_points_agree_with_the_ticks():
    root = drawn(Series("one", [0, 4, 8], [0.0, 2.0, 4.0]))
    ticked = {
        text.text: (float(text.get("x")), float(text.get("y")))
        for text in root.iter(SVG + "text")
        if text.get("x") and text.text in {"0", "2", "4", "8"}
    }
    circles = [(float(c.get("cx")), float(c.get("cy"))) for c in root.iter(SVG + "circle")]
    assert ticked["8"][0] == pytest.approx(circles[2][0], abs=0.11)
    levels = [float(t.get("y")) for t in root.iter(SVG + "text") if t.text == "2" and t.get("text-anchor") == "end"]
    assert levels == [pytest.approx(circles[1][1] + 4, abs=0.11)]


def test_a_logarithmic_axis_has_decades_equally_far_apart():
    root = drawn(Series("one", [0, 1, 2, 3], [0.1, 10.0, 1000.0, 0.0]), y=Axis("y, px", log=True))
    y = [float(c.get("cy")) for c in root.iter(SVG + "circle")]
    assert len(y) == 3  # 0 has no place on it
    assert y[0] - y[1] == pytest.approx(y[1] - y[2], abs=0.11)
    texts = [text.text for text in root.iter(SVG + "text")]
    assert [text for text in texts if text in {"0.1", "1", "10", "100", "1000"}][:5] == [
        "0.1",
        "1",
        "10",
        "100",
        "1000",
    ]


def test_values_that_are_not_finite_are_left_out():
    nan = float("nan")
    root = drawn(Series("one", [0, 1, 2], [1.0, nan, 3.0], [0.5, nan, 2.0], [1.5, nan, 4.0]))
    assert len(list(root.iter(SVG + "circle"))) == 2
    assert len(list(root.iter(SVG + "path"))) == 2
    assert "nan" not in ET.tostring(root, encoding="unicode")


def test_a_range_belongs_to_its_point():
    root = drawn(Series("one", [0, 10], [1.0, 2.0], [0.0, 2.0], [1.0, 3.0]))
    circles = [(c.get("cx"), float(c.get("cy"))) for c in root.iter(SVG + "circle")]
    whiskers = [p.get("d") for p in root.iter(SVG + "path")]
    for (x, y), whisker, end in zip(circles, whiskers, ("high", "low"), strict=True):
        assert whisker.startswith(f"M{x} ")
        low, high = (float(v) for v in whisker[len(f"M{x} ") :].split("M")[0].split("V"))
        assert (high if end == "high" else low) == pytest.approx(y, abs=0.11)


def test_several_series_have_a_legend_one_has_none():
    names = ("first & foremost", "second")
    one, two = (Series(name, [0, 1], [0.0, 1.0]) for name in names)
    texts = [text.text for text in drawn(one, two).iter(SVG + "text")]
    assert all(name in texts for name in names)
    assert names[0] not in [text.text for text in drawn(one).iter(SVG + "text")]


def test_nothing_to_plot_is_said():
    with pytest.raises(ValueError, match="y, mm"):
        drawn(Series("one", [0.0], [float("nan")]))


def test_one_point_can_be_plotted():
    assert len(list(drawn(Series("one", [779.4], [-0.9]), y=Axis("y", zero=True)).iter(SVG + "circle"))) == 1


@pytest.mark.parametrize(("low", "high"), [(0, 1), (-0.3, 0.21), (187, 1013), (-11.2, 10.4), (1e-6, 3e-6)])
def test_ticks_are_round_and_inside(low: float, high: float):
    found = ticks(low, high)
    assert 3 <= len(found) <= 12
    assert low - 1e-9 <= found[0] <= found[-1] <= high * (1 + 1e-9) + 1e-9
    step = found[1] - found[0]
    digit = step / 10 ** math.floor(math.log10(step) + 1e-9)
    assert any(digit == pytest.approx(round_) for round_ in (1, 2, 5))


def test_a_page_escapes_and_checks_its_tables(tmp_path):
    page = Page("a < b")
    page.table(("name", "value"), [("<script>", "1")])
    page.figure(plot("t", Axis("x"), Axis("y"), [Series("one", [0, 1], [0.0, 1.0])]))
    page.write(tmp_path / "sub" / "page.html")
    text = (tmp_path / "sub" / "page.html").read_text()
    assert "<script>" not in text
    assert "&lt;script&gt;" in text
    assert text.count("<svg") == 1
    with pytest.raises(ValueError, match="2 columns"):
        page.table(("name", "value"), [("only one",)])
