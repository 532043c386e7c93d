"""The guided calibration in a real browser: a synthetic camera is shown a board, the page guides it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from common.config import read_calibration
from common.config.quality import read_quality
from tests.support.console_page import DEADLINE_MS, TABLET, PageUnderTest, Site
from tests.support.stack import wait_for

pytestmark = pytest.mark.process

VIEW = "calibrate-bench"
GHOST_BGR = np.array([0xF7, 0xC3, 0x4F])
FOCAL = 460.0


@pytest.fixture
def calibration(site: Site) -> Iterator[PageUnderTest]:
    """The form, before a calibration of `bench`; one that still runs afterwards is ended."""
    page = site.open("setup?calibrate=bench")
    page.drawn(VIEW)
    if page.page.locator(".level, .say").count():
        page.page.get_by_role("button", name="alibrate").click()
    page.page.wait_for_selector("form.board")
    yield page
    page.page.evaluate(
        "fetch('/api/calibration/stop', {method: 'POST', headers: {'content-type': 'application/json'}})"
    )
    wait_for(lambda: state(page)["phase"] in {"idle", "ended"}, why="the calibration's end")


def state(page: PageUnderTest) -> dict:
    found: dict = page.page.evaluate("fetch('/api/calibration').then((answer) => answer.json())")["state"]
    return found


def begin(page: PageUnderTest) -> None:
    page.page.get_by_label("board.yaml").check()
    page.page.get_by_role("button", name="Begin").click()


def folder(site: Site) -> Path:
    return site.session.parent.parent / "calibration"


def views(page: PageUnderTest) -> int:
    return int(page.wait("document.querySelector('[data-views]')?.dataset.views"))


def test_a_ghost_shows_the_next_pose_and_views_are_counted_with_a_verdict(
    site: Site, calibration: PageUnderTest
) -> None:
    page = calibration.page
    begin(calibration)
    calibration.wait("document.querySelector('[data-views]')?.dataset.views >= 2")
    over = calibration.pixels(VIEW, "over")
    ghost = (np.abs(over[..., :3].astype(int) - GHOST_BGR).max(axis=2) < 12) & (over[..., 3] > 240)
    told = state(calibration)["guidance"]
    scale = over.shape[1] / told["size"][0]
    x, y = np.mean([np.array(told["ghost"])], axis=1)[0] * scale
    assert ghost.sum() > 300, "the ghost is drawn"
    rows, columns = np.nonzero(ghost)
    assert columns.min() - 20 < x < columns.max() + 20
    assert rows.min() - 20 < y < rows.max() + 20
    words = page.locator(".verdict-words").inner_text()
    assert "Not yet, because there are only" in words
    assert page.locator(".tilts td").count() == 5

    calibration.press("r")  # whether it is taken or refused depends on where the board is: it is answered at once
    calibration.wait("/taken|as in|like|seen|hold/i.test(document.querySelector('.say').textContent)")
    calibration.press("Backspace")
    wait_for(lambda: state(calibration)["guidance"]["dropped"] == 1, why="a view to be dropped")
    again = site.open("setup?calibrate=bench", size=TABLET)
    again.wait("document.querySelector('[data-views]')")
    told = state(calibration)["guidance"]
    assert told["dropped"] == 1, "the state lives in the server: another page goes on with it"
    again.wait(f"document.querySelector('[data-views]').dataset.views >= {told['views']}")
    again.press("Escape")
    again.page.wait_for_url("**/setup")

    page.get_by_role("button", name="End").click()
    page.wait_for_selector(".say:has-text('what was taken is kept')")
    (kept,) = folder(site).glob("*.views.json")
    assert json.loads(kept.read_text())["views"]
    page.get_by_role("button", name="Calibrate bench").click()
    assert page.get_by_label("Go on with the").is_checked()
    assert calibration.complaints == []


def test_a_wrong_board_is_told_in_words(calibration: PageUnderTest) -> None:
    page = calibration.page
    page.get_by_label("Describe it").check()
    page.get_by_label("Squares across").fill("8")
    page.get_by_role("button", name="Begin").click()
    page.wait_for_selector(".bad-words:has-text('rows')")
    for label, text in (("Squares down", "6"), ("Square, mm", "30"), ("Marker, mm", "22"), ("Family", "/etc/passwd")):
        page.get_by_label(label, exact=True).fill(text)
    page.get_by_role("button", name="Begin").click()
    page.wait_for_selector(".bad-words:has-text('no family of that name')")
    assert state(calibration)["phase"] in {"idle", "ended"}


@pytest.mark.long
def test_it_becomes_good_and_is_saved_with_its_report(site: Site, calibration: PageUnderTest) -> None:
    page = calibration.page
    page.set_default_timeout(4 * DEADLINE_MS)
    begin(calibration)
    page.wait_for_selector(".level:has-text('Good')")
    file = folder(site) / "bench-640x480.yaml"
    label = read_calibration(file, "bench")
    quality = read_quality(file)
    assert quality is not None
    assert quality.verdict == "good"
    assert label.serial == "synthetic-1"
    assert abs(label.matrix[0][0] - FOCAL) < max(4 * quality.sd["fx"], 1.0)
    with page.expect_download() as download:
        page.get_by_role("link", name="Report").click()
    assert "Calibration of bench: good" in download.value.path().read_text()
    assert (folder(site) / "bench-640x480.html").is_file()
    assert "calibration: calibration/bench-640x480.yaml" in page.locator(".record").inner_text()
