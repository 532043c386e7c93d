"""From where an object was recorded, and what to do next."""

from __future__ import annotations

import numpy as np
import pytest

from services.console.coverage import Views, answer, cell_of, direction, next_view, wanted_cells


def sample(azimuth: float, elevation: float, distance: float = 1000.0, name: str = "box-1") -> dict[str, object]:
    return {"objects": [{"name": name, "azimuth_deg": azimuth, "elevation_deg": elevation, "distance_mm": distance}]}


@pytest.mark.parametrize(
    ("azimuth", "elevation", "cell"),
    [
        (-180, -90, (0, 0)),
        (180, 90, (5, 0)),
        (0, 0, (3, 6)),
        (-0.1, -0.1, (2, 5)),
        (179.9, 89.9, (5, 11)),
        (90, 30, (4, 9)),
    ],
)
def test_every_direction_has_a_cell(azimuth: float, elevation: float, cell: tuple[int, int]) -> None:
    assert cell_of(azimuth, elevation) == cell


def test_what_no_marker_can_show_is_not_wanted() -> None:
    front = wanted_cells(["front"])
    assert front[3, 6]
    assert not front[3, 0], "from behind"
    assert not front[5].any(), "from above a front marker is seen too askew"
    assert wanted_cells(["top"])[5].all()
    assert not wanted_cells([]).any()


def test_counts_cells_and_distances() -> None:
    views = Views.of([sample(10, 10), sample(12, 12, 1250), sample(-100, 40, 400), sample(5, 5, name="other")], "box-1")
    told = answer("box-1", views, wanted_cells(["front"]), None)
    assert told["total"] == 3
    assert told["counts"][3][6] == 2
    assert told["counts"][4][2] == 1
    assert (told["views_covered"], told["views_wanted"]) == (1, int(wanted_cells(["front"]).sum()))
    edges, counts = told["distances"]["edges_mm"], told["distances"]["counts"]
    assert len(edges) == len(counts) + 1
    assert sum(counts) == 3
    assert counts[edges.index(1200)] == 1


def test_an_object_without_a_sample() -> None:
    told = answer("box-1", Views.of([], "box-1"), wanted_cells(["front"]), None)
    assert (told["total"], told["views_covered"]) == (0, 0)
    assert told["next"].startswith("Show box-1 from the front")


def test_how_new_a_view_is() -> None:
    views = Views.of([sample(0, 0, 1000), sample(40, 0, 2000)], "box-1")
    degrees, millimetres = views.nearest(direction(10, 0), 1050, 12, 80)
    assert degrees == pytest.approx(10)
    assert millimetres == pytest.approx(50)
    degrees, millimetres = views.nearest(direction(10, 0), 1500, 12, 80)
    assert degrees is None, "from this distance there is none"
    assert millimetres == pytest.approx(500)
    assert Views.of([], "box-1").nearest(direction(0, 0), 1000, 12, 80) == (None, None)


def missing(azimuth: float, elevation: float) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    cells = np.zeros((6, 12), dtype=np.bool_)
    cells[cell_of(azimuth, elevation)] = True
    return cells


def test_the_next_view_in_words() -> None:
    # The right side is at azimuth 90: to see more of it, what faces the camera must go to the left.
    assert next_view("box-1", missing(45, 15), (5.0, 15.0)) == "Turn box-1 about 40° to the left."
    assert next_view("box-1", missing(-45, 15), (5.0, 15.0)) == "Turn box-1 about 50° to the right."
    assert next_view("box-1", missing(-165, 15), (165.0, 15.0)) == "Turn box-1 about 30° to the left."
    above = next_view("box-1", missing(15, 45), (15.0, 10.0))
    assert above == "Bring the camera higher or its top towards the camera by about 35°."
    assert next_view("box-1", np.zeros((6, 12), dtype=np.bool_), (0.0, 0.0)) is None
