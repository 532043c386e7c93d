"""axe-core finds no serious fault in any view, theme and state."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.support.console_page import PageUnderTest, Site

pytestmark = pytest.mark.process

AXE = Path(__file__).parent / "vendor/axe.min.js"
VIEWS = {
    "live": "[data-view=big-cam0-rgb][data-frame]",
    "coverage": "table.map",
    "health": "table.services tbody tr",
    "setup": ".objects table",
    "gallery": ".tile, .empty",
}


def faults(page: PageUnderTest) -> list[dict[str, Any]]:
    """What axe calls serious or critical, in short. Evaluated, not added as a script: the page's CSP stays as it is."""
    page.page.evaluate(AXE.read_text())
    found = page.page.evaluate("axe.run(document, {resultTypes: ['violations']})")
    return [
        {
            "rule": one["id"],
            "what": one["help"],
            "where": [(node["target"], node["failureSummary"]) for node in one["nodes"][:4]],
        }
        for one in found["violations"]
        if one["impact"] in {"serious", "critical"}
    ]


@pytest.mark.parametrize("theme", ["light", pytest.param("dark", marks=pytest.mark.long)])
@pytest.mark.parametrize("view", VIEWS)
def test_no_view_has_a_serious_fault(site: Site, view: str, theme: str) -> None:
    page = site.open(view, theme=theme)
    page.page.wait_for_selector(VIEWS[view])
    assert faults(page) == []


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_no_state_has_a_serious_fault(site: Site, theme: str) -> None:
    page = site.open("live", theme=theme)
    page.drawn()
    page.press("?")
    page.page.wait_for_selector("dialog[open]")
    assert faults(page) == []
    page.press("Escape")
    page.page.get_by_role("radio", name="Every").check()
    page.press("r")
    page.phase("recording")
    assert faults(page) == []
    page.press("x")
    page.phase("ready")
