"""A real browser before the real console: one stack, one Chromium, pages that remember complaints."""

from __future__ import annotations

import base64
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.stack import wait_for
from tests.support.supervised import DEADLINE_S, SupervisedStack, supervised

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

DESKTOP = {"width": 1280, "height": 800}
TABLET = {"width": 820, "height": 1180}
DEADLINE_MS = DEADLINE_S * 1000
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def chromium() -> str:
    """The browser's path; without one (or without Playwright) the test is skipped, or fails where CI=true."""
    path = os.environ.get("TAGMILL_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    try:
        import playwright.sync_api  # noqa: F401 - only to see whether it is there
    except ImportError:
        path = None
    if path is None:
        reason = "no Chromium or no Playwright: the console's page was not tested (apt-get install chromium)"
        if os.environ.get("CI") == "true":
            pytest.fail(reason, pytrace=False)
        pytest.skip(reason)
    return path


@contextmanager
def browser_of(path: str) -> Iterator[Browser]:
    """A headless Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        try:
            yield browser
        finally:
            browser.close()


@dataclass
class Site:
    """A running stack with its console."""

    url: str
    stack: SupervisedStack
    session: Path
    browser: Browser
    contexts: list[BrowserContext] = field(default_factory=list)

    def open(
        self, view: str, *, size: dict[str, int] | None = None, theme: str = "light", **options: Any
    ) -> PageUnderTest:
        """A page of its own (fresh settings), connected and with its view drawn."""
        context = self.browser.new_context(
            viewport=size or DESKTOP, color_scheme=theme, reduced_motion="reduce", **options
        )
        self.contexts.append(context)
        page = PageUnderTest(context.new_page(), self.url)
        page.go(view)
        return page

    def close_pages(self) -> None:
        """Close what a test opened."""
        while self.contexts:
            self.contexts.pop().close()

    def samples(self) -> list[str]:
        """Names of the samples on the disk, the bin's left out."""
        return sorted(path.stem.removeprefix("label_") for path in (self.session / "label").glob("label_*.json"))


class PageUnderTest:
    """Playwright's page, with what this console's tests ask again and again."""

    def __init__(self, page: Page, url: str) -> None:
        self.page = page
        self.url = url
        self.complaints: list[str] = []
        page.set_default_timeout(DEADLINE_MS)
        page.on(
            "console", lambda said: self.complaints.append(said.text) if said.type in {"error", "warning"} else None
        )
        page.on("pageerror", lambda error: self.complaints.append(str(error)))

    def go(self, view: str) -> None:
        """Open a view and wait until the stack has been heard."""
        self.page.goto(f"{self.url}/{view}")
        self.page.wait_for_selector("html:not([data-phase='unknown'])", state="attached")

    def phase(self, wanted: str) -> None:
        """Until the record state is this."""
        self.page.wait_for_selector(f"html[data-phase='{wanted}']", state="attached")

    def press(self, *keys: str) -> None:
        """Keys, one after the other."""
        for key in keys:
            self.page.keyboard.press(key)

    def wait(self, expression: str) -> Any:
        """Until a JavaScript expression is true; its value. Asked from outside: the page's policy forbids `eval`."""
        return wait_for(lambda: self.page.evaluate(expression), DEADLINE_S, expression)

    def drawn(self, view: str = "big-cam0-rgb") -> int:
        """Until a view has drawn a picture; its frame."""
        return int(self.wait(f"document.querySelector('[data-view=\"{view}\"]')?.dataset.frame"))

    def pixels(self, view: str, layer: str) -> NDArray[np.uint8]:
        """A canvas's pixels (H, W, 4) BGRA; ``layer``: picture or over."""
        script = (
            "([view, layer]) => document.querySelector(`[data-view='${view}'] canvas.${layer}`).toDataURL('image/png')"
        )
        data = base64.b64decode(self.page.evaluate(script, [view, layer]).partition(",")[2])
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        assert image is not None
        return np.asarray(image, np.uint8)


def markers_in(picture: NDArray[np.uint8]) -> dict[int, NDArray[np.float64]]:
    """OpenCV's own search for tagStandard 36h11 markers: id to corners (4, 2) px, integer = pixel centre."""
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    grey = cv2.cvtColor(picture, cv2.COLOR_BGRA2GRAY if picture.shape[2] == 4 else cv2.COLOR_BGR2GRAY)
    corners, ids, _ = detector.detectMarkers(grey)
    found = [] if ids is None else ids.ravel()
    return {int(marker): quad.reshape(4, 2).astype(np.float64) for marker, quad in zip(found, corners, strict=True)}


@contextmanager
def console_site(rig: Path, session: Path, *cameras: str) -> Iterator[Site]:
    """`tagmill up` with ``rig``, and a browser; the console's address is the one that it tells in its heartbeat."""
    path = chromium()
    with supervised(rig, *cameras) as stack:

        def url() -> str | None:
            console = stack.status()["services"].get("console") or {}
            return (console.get("texts") or {}).get("url")

        address = wait_for(url, DEADLINE_S, "the console's address")
        with browser_of(path) as browser:
            site = Site(address, stack, session, browser)
            try:
                yield site
            finally:
                site.close_pages()
