"""Coverage, Health and Gallery in a real browser; foreign pages; keys without a mouse."""

from __future__ import annotations

import re
import time
from pathlib import Path

import psutil
import pytest

from tests.support.console_page import DEADLINE_MS, PageUnderTest, Site
from tests.support.hygiene import Place
from tests.support.stack import Stack, wait_for

pytestmark = pytest.mark.process

EVIL = "http://evil.test"
QUIET_S = 25.0


def record(site: Site, count: int) -> list[str]:
    """Samples by the command socket, so that there is something to show."""
    before = set(site.samples())
    answer = site.stack.ask(command="record", camera="cam0", count=count, timeout_s=60.0)
    assert answer["ok"], answer
    return sorted(set(site.samples()) - before, reverse=True)


def covered(page: PageUnderTest) -> int:
    counts = "[...document.querySelectorAll('table.map td.cell')].map((cell) => Number(cell.dataset.count))"
    return sum(page.page.evaluate(counts))


def test_coverage_grows_with_what_is_recorded(site: Site) -> None:
    page = site.open("coverage")
    page.page.wait_for_selector("table.map")
    page.page.wait_for_selector("td[data-now]")
    before = covered(page)
    record(site, 2)
    wait_for(lambda: covered(page) == before + 2, why="two more samples on the map")
    assert re.match(r"[1-9]\d* of \d+ views", page.page.locator(".views").inner_text())
    assert page.page.locator(".histogram li").count() > 0
    assert "Fit" in page.page.locator("table.limits").inner_text()


def test_killing_detect_shows_and_heals(site: Site) -> None:
    page = site.open("health")
    page.page.wait_for_selector("tr:has-text('detect.0'):has-text('running')")
    page.page.wait_for_selector("tr:has-text('detect.0') td.number:text-matches('[0-9]+ %')")
    page.page.wait_for_selector(".room :text-matches('MB of|GB of')")
    # The console says nothing of what dies in its first 10 seconds, in which a stack comes up.
    started = psutil.Process(site.stack.pids()["console"]).create_time()
    wait_for(lambda: time.time() - started > QUIET_S, why="the console to have run for a while")
    killed = site.stack.kill("detect")
    # A quick supervisor has it back before anybody misses its heartbeat: then only the return is news.
    page.page.wait_for_selector(".sentences :text-matches('detect.0 came back after')")
    site.stack.wait_back("detect", killed)
    page.page.wait_for_selector("tr:has-text('detect.0'):has-text('running')")
    page.press("1")
    page.page.wait_for_selector(".can:not(.bad)")


def test_the_gallery_deletes_and_restores(site: Site) -> None:
    newest = record(site, 2)[0]
    page = site.open("gallery")
    tile = f"[data-name='{newest}']"
    page.page.wait_for_selector(tile)
    page.wait("document.querySelector('.tile img').naturalWidth > 0")
    page.page.locator(f"{tile} .tick").click()
    page.page.get_by_role("button", name="To the bin").click()
    page.page.wait_for_selector(".toast:has-text('1 moved to the bin.')")
    page.page.wait_for_selector(tile, state="detached")
    assert newest not in site.samples()
    page.page.get_by_role("button", name=re.compile(r"^Bin \d")).click()
    page.page.wait_for_selector(tile)
    page.page.locator(f"{tile} .tick").click()
    page.press("v")
    page.page.wait_for_selector(tile, state="detached")
    wait_for(lambda: newest in site.samples(), why="the sample to be back")
    assert page.complaints == []


def test_a_filter_lives_in_the_address_and_can_be_cleared(site: Site) -> None:
    record(site, 1)
    page = site.open("gallery")
    page.page.wait_for_selector(".tile")
    page.press("/")
    page.page.get_by_label("Quality").select_option("background")
    page.page.wait_for_selector(":text('No sample matches.')")
    assert page.page.url.endswith("quality=background")
    page.page.locator(".empty").get_by_role("button", name="Clear the filter").click()
    page.page.wait_for_selector(".tile")


def test_an_opened_sample_shows_before_and_after_with_its_label(site: Site) -> None:
    newest = record(site, 1)[0]
    page = site.open(f"gallery?sample={newest}")
    page.page.wait_for_selector(".opened [data-drawn]")
    assert newest in page.page.locator(".opened h1").inner_text()
    page.press("i")
    page.page.wait_for_selector(".opened [data-kind=original][data-drawn]")
    page.page.wait_for_selector(".opened [data-kind=rgb][data-drawn]")
    page.page.go_back()
    assert page.complaints == []


def test_everything_that_matters_goes_by_keyboard(site: Site) -> None:
    record(site, 2)
    page = site.open("live")
    page.drawn()
    page.press("Tab")
    assert page.page.evaluate("document.activeElement.className").startswith("skip")
    page.press("Enter")
    page.press("?")
    page.page.wait_for_selector("dialog[open]")
    before = len(site.samples())
    page.press("r")  # nothing fires under a dialog
    page.press("Escape")
    page.page.wait_for_selector("dialog:not([open])", state="attached")
    assert len(site.samples()) == before
    for key, view in (("2", "coverage"), ("3", "health"), ("4", "setup"), ("5", "gallery")):
        page.press(key)
        page.page.wait_for_url(f"**/{view}")
    page.page.wait_for_selector(".tile")
    page.press("ArrowRight", "ArrowLeft", "Space")
    page.page.wait_for_selector(".tile[aria-selected=true]")
    page.press("Escape")
    page.page.wait_for_selector(".tile[aria-selected=true]", state="detached")
    page.press("Enter")
    page.page.wait_for_selector(".opened")
    page.press("Escape")
    page.page.wait_for_selector(".tile")
    page.press("1")
    page.drawn()
    wait_for(lambda: page.page.locator(".can:not(.bad)").count(), why="something to record")
    page.press("Space")
    wait_for(lambda: len(site.samples()) == before + 1, why="a sample without touching the mouse")


def test_a_page_from_elsewhere_can_do_nothing(site: Site) -> None:
    before = site.samples()
    page = site.open("live")
    page.page.route(f"{EVIL}/**", lambda route: route.fulfill(body="<!doctype html><p>hello", content_type="text/html"))
    page.page.goto(EVIL)
    outcome = page.page.evaluate(
        """async (url) => {
            const body = JSON.stringify({camera: "cam0"});
            const post = (type) => fetch(
                `${url}/api/commands/record`, {method: "POST", mode: "no-cors", headers: {"content-type": type}, body});
            await Promise.allSettled([post("text/plain"), post("application/json")]);
            const read = await fetch(`${url}/api/status`).then(() => "read", () => "refused");
            const socket = await new Promise((done) => {
                const ws = new WebSocket(url.replace("http", "ws") + "/ws");
                ws.onopen = () => done("open");
                ws.onclose = () => done("refused");
            });
            return [read, socket];
        }""",
        site.url,
    )
    assert outcome == ["refused", "refused"]
    assert site.samples() == before


def test_off_loopback_a_page_needs_the_token_which_leaves_the_address(site: Site, place: Place, tmp_path: Path) -> None:
    """A console of its own, without a stack: what it lets in doesn't depend on one."""
    rig = tmp_path / "rig.yaml"
    rig.write_text("network: {console: 'http://0.0.0.0:0'}\ncameras:\n  cam0: {driver: synthetic}\n")
    process = Stack(place, tmp_path).start_service("console", rig, TAGMILL_PREFIX=f"{place.prefix}b")
    try:
        url = str(process.wait_for_event("console.ready")["url"]).replace("0.0.0.0", "127.0.0.1")
        plain = url.partition("/?token=")[0]
        context = site.browser.new_context()
        site.contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(DEADLINE_MS)
        statuses = [page.goto(address).status for address in (f"{plain}/live", f"{plain}/?token=wrong", url)]
        assert statuses == [401, 401, 200]
        assert page.url == f"{plain}/live"
        page.wait_for_selector(".top")
        assert "token" not in page.evaluate("document.cookie + location.href + document.referrer")
        (cookie,) = context.cookies()
        assert (cookie["httpOnly"], cookie["sameSite"]) == (True, "Strict")
        opened = """(url) => new Promise((done) => {
            const ws = new WebSocket(url.replace("http", "ws") + "/ws");
            ws.onopen = () => done("open");
            ws.onclose = () => done("refused");
        })"""
        assert page.evaluate(opened, plain) == "open"
        context.clear_cookies()
        assert page.evaluate(opened, plain) == "refused"
    finally:
        assert process.stop() == 0


def test_a_lost_connection_is_said_and_healed(site: Site) -> None:
    page = site.open("health")
    page.page.close()
    context = site.browser.new_context(viewport={"width": 1280, "height": 800})
    site.contexts.append(context)
    page = PageUnderTest(context.new_page(), site.url)
    routes: list = []
    allowed = [True]

    def route(socket) -> None:
        routes.append(socket)
        if allowed[0]:
            socket.connect_to_server()
        else:
            socket.close()

    page.page.route_web_socket("**/ws", route)
    page.go("live")
    page.phase("ready")
    allowed[0] = False
    routes[-1].close()
    page.phase("unknown")
    page.page.wait_for_selector(":text('NO CONNECTION')")
    assert page.page.locator(".take").is_disabled()
    allowed[0] = True
    page.phase("ready")


@pytest.mark.parametrize("view", ["live", "coverage", "health", "setup", "gallery"])
def test_a_phone_scrolls_one_way_only(site: Site, view: str) -> None:
    page = site.open(view, size={"width": 320, "height": 640})
    page.page.wait_for_selector("main h1", state="attached")
    page.page.wait_for_load_state("networkidle")
    assert page.page.evaluate("document.documentElement.scrollWidth") == 320
