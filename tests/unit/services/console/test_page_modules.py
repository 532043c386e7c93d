"""The page's pure modules by Node's own test runner, and what every file of the page must keep to."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

STATIC = Path(__file__).resolve().parents[4] / "services/console/static"
TESTS = sorted((Path(__file__).parent / "js").glob("*.test.mjs"))
OWN = sorted(path for path in STATIC.rglob("*") if path.is_file() and "vendor" not in path.parts)
MAX_LINES = 300


def test_the_pure_modules_do_what_they_say() -> None:
    node = shutil.which("node")
    if node is None:
        reason = "node is not installed: the page's modules were not tested (apt-get install nodejs)"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    done = subprocess.run([node, "--test", *map(str, TESTS)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]


@pytest.mark.parametrize("path", [path for path in OWN if path.suffix in {".js", ".css"}], ids=lambda path: path.name)
def test_no_file_is_longer_than_a_reader_can_hold(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= MAX_LINES


def test_nothing_is_fetched_from_elsewhere() -> None:
    for path in OWN:
        found = re.findall(r"https?://[^\s\"'`<>)]+", path.read_text())
        assert set(found) <= {"http://www.w3.org/2000/svg"}, path


def test_what_modules_and_the_page_name_is_there() -> None:
    page = (STATIC / "index.html").read_text()
    bare = json.loads(re.search(r'<script type="importmap">(.*?)</script>', page, re.DOTALL)[1])["imports"]  # type: ignore[index]
    assert all((STATIC / target.removeprefix("/static/")).is_file() for target in bare.values())
    assert all((STATIC / name).is_file() for name in re.findall(r'(?:href|src)="/static/([^"]+)"', page))
    for path in (STATIC / "js").rglob("*.js"):
        for name in re.findall(r'^import [^;]*?from "([^"]+)"', path.read_text(), re.MULTILINE):
            assert name in bare or (path.parent / name).is_file(), f"{path.name} imports {name}"


def test_icons_that_are_used_are_in_the_sprite() -> None:
    sprite = (STATIC / "vendor/icons.svg").read_text()
    for path in (STATIC / "js").rglob("*.js"):
        for name in re.findall(r'Icon} name="([a-z0-9-]+)"', path.read_text()):
            assert f'id="{name}"' in sprite, f"{path.name} uses {name}"
