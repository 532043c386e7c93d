"""``python -m tests.browser.screenshots [VIEW ...]``: the pictures in docs/images/console, by a real browser.

With names of views only theirs are taken anew.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.boards import Board, write_board
from tests.support.console_page import DESKTOP, TABLET, PageUnderTest, Site, console_site
from tests.support.hygiene import own_place
from tests.support.stack import ROOT

OUT = ROOT / "docs/images/console"
EXAMPLE = ROOT / "deploy/examples/synthetic.yaml"
BOARD = Board(kind="charuco", columns=8, rows=6, square_mm=30, marker_mm=22, family="5x5_250")
CAMERAS = """\
cameras:
  cam0: {driver: synthetic, width: 1280, height: 720, fps: 6, depth: true, seed: 1, prerendered: 40}
  cam1: {driver: synthetic, width: 640, height: 360, fps: 3, seed: 2, prerendered: 12}
"""
BENCH = """\
  bench: {driver: synthetic, width: 1280, height: 720, fps: 8, board: board.yaml, speed: 2.0, focal_px: 900}
"""
QUALITY = 82
SAMPLES = 14
READY = {
    "live": "[data-view=big-cam0-rgb][data-frame]:not([data-stale])",
    "coverage": "td[data-now]",
    "health": ".chart canvas",
    "setup": "[data-view=setup-cam0][data-frame]",
    "gallery": ".tile",
}


def main() -> int:
    """Record a few samples, then take every picture."""
    OUT.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as folder,
        pytest.MonkeyPatch.context() as patch,
        own_place(patch),
    ):
        text = EXAMPLE.read_text().replace("../../dataset", "./dataset").replace("session: synthetic", "session: boxes")
        rig = Path(folder) / "rig.yaml"
        rig.write_text(
            text[: text.index("cameras:")].replace("session: boxes}", "session: boxes, keep_original: true}") + CAMERAS
        )
        if sys.argv[1:] == ["calibrate"]:
            calibrating(Path(folder))
            return 0
        with console_site(rig, Path(folder) / "dataset" / "boxes", "cam0", "cam1") as site:
            site.stack.ask(command="record", camera="cam0", count=SAMPLES, interval_s=0.7, timeout_s=90.0)
            take_all(site)
        if not sys.argv[1:]:
            (Path(folder) / "bench").mkdir()
            calibrating(Path(folder) / "bench")
    return 0


def take_all(site: Site) -> None:
    """Each view in both themes and on the tablet, and the states that the guide shows."""
    wanted = sys.argv[1:] or list(READY)
    for view, ready in ((view, READY[view]) for view in wanted):
        for name, size, theme in (("light", DESKTOP, "light"), ("dark", DESKTOP, "dark"), ("tablet", TABLET, "light")):
            page = site.open(view, size=size, theme=theme)
            page.page.wait_for_selector(ready)
            if view == "gallery":
                page.wait("[...document.querySelectorAll('.tile img')].slice(0, 10).every((one) => one.naturalWidth)")
            if view == "live":
                settled(page)
            save(page, f"{view}-{name}")
            site.close_pages()
    if sys.argv[1:]:
        return
    opened(site)
    split(site)
    recording(site)


def calibrating(folder: Path) -> None:
    """A calibration half-way, in both themes and on the tablet: a stack of its own, whose camera is shown a board."""
    rig = folder / "rig.yaml"
    rig.write_text("dataset: {root: ./dataset, session: boxes}\ncameras:\n" + BENCH)
    write_board(folder / "board.yaml", BOARD)
    with console_site(rig, folder / "dataset" / "boxes", "bench") as site:
        page = site.open("setup?calibrate=bench")
        page.page.get_by_label("board.yaml").check()
        page.page.get_by_role("button", name="Begin").click()
        page.wait("document.querySelector('[data-views]')?.dataset.views >= 4")
        page.drawn("calibrate-bench")
        for name, size, theme in (("tablet", TABLET, "light"), ("dark", DESKTOP, "dark"), ("light", DESKTOP, "light")):
            page.page.emulate_media(color_scheme=theme)  # type: ignore[arg-type]
            page.page.set_viewport_size(size)  # type: ignore[arg-type]
            save(page, f"calibrate-{name}")


def settled(page: PageUnderTest) -> None:
    """Until the big picture has its label, its rate is known, and the thumbnail is there."""
    page.wait("document.querySelector('.last img')?.naturalWidth > 0")
    page.wait("/[1-9].*s/.test(document.querySelector('.bigpicture .caption-line span:nth-of-type(3)').textContent)")
    page.wait("document.querySelector('[data-view=small-cam1]')?.dataset.frame")
    page.wait("document.querySelector('[data-view=big-cam0-rgb]').label?.objects?.length")
    page.page.wait_for_selector(".trouble", state="detached")


def opened(site: Site) -> None:
    """A sample, large."""
    page = site.open(f"gallery?sample={site.samples()[-1]}")
    page.page.wait_for_selector(".opened [data-drawn]")
    page.page.wait_for_selector(".opened table")
    save(page, "sample")
    site.close_pages()


def split(site: Site) -> None:
    """Before and after."""
    page = site.open("live")
    page.press("i")
    page.page.wait_for_selector("[data-view=after-cam0][data-frame]:not([data-stale])")
    page.press("o")
    save(page, "split")
    site.close_pages()


def recording(site: Site) -> None:
    """While a recording runs."""
    page = site.open("live", theme="dark")
    page.drawn()
    page.page.get_by_role("radio", name="Every").check()
    page.press("r")
    page.phase("recording")
    page.wait("document.querySelector('.last img')?.naturalWidth > 0")
    settled(page)
    save(page, "recording")
    page.press("x")
    page.phase("ready")


def save(page: PageUnderTest, name: str) -> None:
    """A small JPEG."""
    page.page.evaluate("document.fonts.ready")
    png = page.page.screenshot(type="png")
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    cv2.imwrite(str(OUT / f"{name}.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    print(OUT / f"{name}.jpg")


if __name__ == "__main__":
    sys.exit(main())
