"""One stack and one browser for all tests of this folder: starting them takes longer than any of the tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from common.boards import Board, write_board
from tests.support.console_page import PageUnderTest, Site, chromium, console_site
from tests.support.hygiene import Place, own_place

RIG = """\
dataset: {root: ./dataset, session: browser, keep_original: true}
markers: {family: apriltag_36h11}
objects:
  - name: box-1
    size_mm: {width: 400, height: 300, depth: 300}
    sides:
      front: {marker: 0, marker_size_mm: 120, border_mm: 15}
      left:  {marker: 1, marker_size_mm: 120, border_mm: 15}
      right: {marker: 2, marker_size_mm: 120, border_mm: 15}
      back:  {marker: 3, marker_size_mm: 120, border_mm: 15}
      lid:   {face: top, marker: 4, marker_size_mm: 120, border_mm: 15}
pose: {ambiguous: keep}
record: {incomplete: keep}
cameras:
  cam0: {driver: synthetic, width: 640, height: 360, fps: 5, depth: true, seed: 3, prerendered: 24}
  bench: {driver: synthetic, width: 640, height: 480, fps: 6, board: board.yaml, speed: 2.5, focal_px: 460}
"""
BOARD = Board(kind="charuco", columns=8, rows=6, square_mm=30, marker_mm=22, family="5x5_250")
"""What `bench` is shown."""


@pytest.fixture(scope="package")
def shared_place() -> Iterator[Place]:
    """The prefix and run folder of the one stack."""
    chromium()
    with pytest.MonkeyPatch.context() as patch, own_place(patch) as own:
        yield own


@pytest.fixture(autouse=True)
def place(shared_place: Place) -> Place:
    """Instead of a place for each test: what is left behind is looked for once, at the end."""
    return shared_place


@pytest.fixture(scope="package")
def running(shared_place: Place, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """The stack, its console and a browser."""
    folder = tmp_path_factory.mktemp("console")
    rig = folder / "rig.yaml"
    rig.write_text(RIG)
    write_board(folder / "board.yaml", BOARD)
    with console_site(rig, folder / "dataset" / "browser", "cam0", "bench") as site:
        yield site


@pytest.fixture
def site(running: Site) -> Iterator[Site]:
    """The running console; the test's pages are closed after it."""
    yield running
    running.close_pages()


@pytest.fixture
def live(site: Site) -> PageUnderTest:
    """The Live view with a picture in it."""
    page = site.open("live")
    page.drawn()
    return page
