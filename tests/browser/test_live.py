"""Live and Record in a real browser, with the real stack behind it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.console_page import PageUnderTest, Site, markers_in
from tests.support.stack import wait_for

pytestmark = pytest.mark.process

VIEWS = ("live", "coverage", "health", "setup", "gallery")
BIG = "big-cam0-rgb"


@pytest.mark.parametrize("view", VIEWS)
def test_every_view_loads_without_a_complaint(site: Site, view: str) -> None:
    page = site.open(view)
    page.page.wait_for_selector("main h1", state="attached")
    page.page.wait_for_load_state("networkidle")
    assert page.complaints == []
    assert page.page.locator("main h1").count() == 1
    assert page.page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_the_picture_moves(live: PageUnderTest) -> None:
    first, before = live.drawn(), live.pixels(BIG, "picture")
    live.wait(f"Number(document.querySelector('[data-view={BIG}]').dataset.frame) > {first + 5}")
    # The camera plays its pictures to and fro: once in a while one is just like the first.
    wait_for(
        lambda: np.abs(before.astype(int) - live.pixels(BIG, "picture")).max() > 30, why="a picture that is another"
    )


def hold_with_a_label(page: PageUnderTest) -> dict:
    """Hold a picture still that has an object with at least one marker in its label."""
    view = f"document.querySelector('[data-view={BIG}]')"
    found = f"{view}.label?.objects?.[0]?.sides?.length"

    def held() -> dict | None:
        page.wait(found)
        page.press("h")
        page.page.wait_for_selector(".trouble.held")
        if page.page.evaluate(found):
            return dict(page.page.evaluate(f"{view}.label"))
        page.press("h")  # a picture without an object came between
        page.page.wait_for_selector(".trouble.held", state="detached")
        return None

    return wait_for(held, why="a held picture with a label")


def test_the_label_is_that_of_the_picture_it_is_drawn_on(live: PageUnderTest) -> None:
    live.page.set_viewport_size({"width": 1600, "height": 1000})
    live.wait(f"document.querySelector('[data-view={BIG}] canvas.picture').width === 640")
    label = hold_with_a_label(live)
    seen = markers_in(live.pixels(BIG, "picture"))
    sides = {side["marker"]: np.array(side["marker_corners"]) for item in label["objects"] for side in item["sides"]}
    both = seen.keys() & sides.keys()
    assert both
    for marker in both:
        # OpenCV begins at another corner. JPEG and its coarser corners cost less than what the box moves in a frame.
        turned = [np.abs(np.roll(seen[marker], turn, axis=0) - sides[marker]).max() for turn in range(4)]
        assert min(turned) < 4.0


def test_the_overlay_lies_on_the_box(live: PageUnderTest) -> None:
    label = hold_with_a_label(live)
    for key in "kcdep":
        live.press(key)
    live.page.wait_for_selector("[aria-keyshortcuts=P][aria-pressed=false]")
    over = live.pixels(BIG, "over")
    scale = over.shape[1] / 640
    ink = over[..., 3] > 0
    inside = [
        (corner["x"], corner["y"])
        for item in label["objects"]
        for corner in item["corners"]
        if corner["x"] is not None and corner["in_image"]
    ]
    assert inside
    for x, y in inside:
        row, column = int((y + 0.5) * scale), int((x + 0.5) * scale)
        assert ink[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2].any()
    allowed = np.zeros_like(ink)
    for item in label["objects"]:
        at = {corner["name"]: (corner["x"], corner["y"]) for corner in item["corners"] if corner["x"] is not None}
        draw_edges(allowed, at, scale)
    assert not (ink & ~allowed).any()


def draw_edges(mask: np.ndarray, at: dict[str, tuple[float, float]], scale: float) -> None:
    """Where a stroke of the box may be: within 5 px of one of its edges."""
    import cv2

    canvas = mask.astype(np.uint8)
    names = [tuple(name.split("_")) for name in at]
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            if sum(a != b for a, b in zip(one, other, strict=True)) == 1:
                ends = [tuple(round((n + 0.5) * scale) for n in at["_".join(name)]) for name in (one, other)]
                cv2.line(canvas, *ends, 1, 11)
    mask |= canvas.astype(bool)


def test_each_overlay_has_its_key_and_its_button(live: PageUnderTest) -> None:
    hold_with_a_label(live)
    amounts = set()
    for key in "okbwcdep":
        live.press(key)
        amounts.add(int((live.pixels(BIG, "over")[..., 3] > 0).sum()))
    assert len(amounts) > 4
    live.page.get_by_role("button", name="Overlays O").click()
    assert not live.pixels(BIG, "over")[..., 3].any()


def test_space_records_what_is_seen_and_says_so_everywhere(site: Site, live: PageUnderTest) -> None:
    before = site.samples()
    live.page.wait_for_selector(".can:not(.bad)")
    live.press("Space")
    wait_for(lambda: len(site.samples()) > len(before), why="a sample by the space bar")
    (new,) = set(site.samples()) - set(before)
    live.page.wait_for_selector(f".last img[src*='{new}']")
    live.wait("document.querySelector('.last img').naturalWidth > 0")
    assert live.complaints == []


def test_undo_moves_the_last_one_to_the_bin(site: Site, live: PageUnderTest) -> None:
    before = set(site.samples())
    live.page.wait_for_selector(".can:not(.bad)")
    live.press("r")
    wait_for(lambda: len(site.samples()) > len(before), why="a sample")
    live.page.wait_for_selector(".last button")
    live.wait("document.documentElement.dataset.phase === 'ready'")
    (new,) = set(site.samples()) - before
    live.page.wait_for_selector(f".last img[src*='{new}']")
    live.press("u")
    wait_for(lambda: set(site.samples()) == before, why="the sample to be in the bin")
    live.page.wait_for_selector(".toast")
    live.page.get_by_role("button", name="Put back").click()
    wait_for(lambda: new in site.samples(), why="the sample to be back")


def test_what_waits_for_a_picture_that_fits_can_be_cancelled(site: Site, live: PageUnderTest) -> None:
    before = site.samples()
    live.page.keyboard.press(".")
    live.drawn("big-bench-rgb")
    live.page.wait_for_selector(".can.bad:has-text('No object in view')")
    live.press("r")
    live.phase("asked")
    assert live.page.locator(".take").inner_text().startswith("Cancel")
    assert "WAITING" in live.page.locator(".state").inner_text()
    live.page.locator(".take").click()
    live.phase("ready")
    live.press("r")
    live.page.wait_for_selector(".toast:has-text('No object in view')")
    live.phase("ready")
    assert site.samples() == before


def test_a_recording_is_said_in_six_places_and_a_double_press_does_not_stop_it(site: Site, live: PageUnderTest) -> None:
    live.page.get_by_role("radio", name="Every").check()
    # The second half of a double click, at the very moment at which the recording is seen to run: ignored.
    live.page.evaluate("""() => new MutationObserver((_, self) => {
        if (document.documentElement.dataset.phase !== "recording") return;
        self.disconnect();
        document.body.dispatchEvent(new KeyboardEvent("keydown", {key: "r", code: "KeyR", bubbles: true}));
        document.documentElement.dataset.pressed = "twice";
    }).observe(document.documentElement, {attributes: true, attributeFilter: ["data-phase"]})""")
    live.press("r")
    live.phase("recording")
    live.page.wait_for_selector("html[data-pressed]", state="attached")
    live.wait("document.title.startsWith('●')")
    assert live.page.locator(".state").inner_text().startswith("RECORDING")
    assert live.page.locator(".take").inner_text().startswith("Stop")
    assert live.page.locator("#favicon").get_attribute("href") == "/static/icons/recording.svg"
    frame = live.page.evaluate("getComputedStyle(document.getElementById('app'), '::after').borderTopColor")
    assert frame == "rgb(196, 22, 31)"
    live.wait("document.querySelector('[role=status]').textContent.includes('recording')")
    wait_for(lambda: site.stack.status()["recordings"], why="the recording in the stack's own status")
    live.press("Escape")
    assert live.page.evaluate("document.documentElement.dataset.phase") == "recording"
    live.press("x")
    live.phase("ready")


def test_the_split_shows_no_marker_behind_the_divider(live: PageUnderTest) -> None:
    live.page.set_viewport_size({"width": 1600, "height": 1000})
    live.press("i")
    live.drawn("after-cam0")
    same = """() => {
        const [before, after] = ['before', 'after'].map((side) => document.querySelector(`[data-view=${side}-cam0]`));
        const seen = after.label?.objects?.[0]?.sides?.length;
        const wide = after.querySelector('canvas').width === 640 && before.querySelector('canvas').width === 640;
        return seen && wide && before.dataset.frame === after.dataset.frame;
    }"""
    live.wait(same)
    live.press("h")
    live.wait(same)
    assert markers_in(live.pixels("before-cam0", "picture"))
    assert not markers_in(live.pixels("after-cam0", "picture"))
    divider = live.page.get_by_role("slider", name="Divider")
    divider.focus()
    live.press("ArrowLeft")
    assert int(divider.input_value()) == 49


def test_depth_has_a_legend_in_millimetres(live: PageUnderTest) -> None:
    live.press("t")
    live.drawn("big-cam0-depth")
    live.page.wait_for_selector(".bigpicture .legend")
    assert " mm" in live.page.locator(".bigpicture .legend").inner_text()


def test_a_hidden_tab_costs_nothing(live: PageUnderTest) -> None:
    show = """(state) => {
        Object.defineProperty(document, "visibilityState", {value: state, configurable: true});
        document.dispatchEvent(new Event("visibilitychange"));
    }"""
    live.page.evaluate(show, "hidden")
    frame = f"document.querySelector('[data-view={BIG}]').dataset.frame"
    live.page.wait_for_selector(f"[data-view={BIG}][data-stale]")
    still = live.page.evaluate(frame)
    assert (
        "old" in live.page.locator(".bigpicture .caption-line").inner_text()
        or "No picture for" in live.page.locator(".trouble").inner_text()
    )
    assert live.page.evaluate(frame) == still
    live.page.evaluate(show, "visible")
    live.wait(f"{frame} !== '{still}'")
    live.page.wait_for_selector(f"[data-view={BIG}]:not([data-stale])")


def test_the_disk_keeps_what_the_page_says(site: Site, live: PageUnderTest) -> None:
    shown = live.wait("document.querySelector('.fact b').textContent.trim()")
    wait_for(
        lambda: int(live.page.locator(".fact b").first.inner_text()) == len(site.samples()), why=f"{shown} samples"
    )
    assert Path(site.session / "session.json").is_file()
