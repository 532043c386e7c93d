"""The web parts that are shipped are, byte for byte, those that were checked when they were fetched."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from tools.vendor_web import FOLDERS, sprite


def packages(folder: Path) -> list[dict[str, Any]]:
    return list(json.loads((folder / "VENDOR.json").read_text())["packages"])


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.parent.name)
def test_every_file_is_the_one_that_was_checked(folder: Path) -> None:
    listed = {name: sha for package in packages(folder) for name, sha in package["sha256"].items()}
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()} - {"VENDOR.json"}
    assert there == set(listed)
    assert {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in listed} == listed


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.parent.name)
def test_every_package_says_where_it_is_from_and_its_licence(folder: Path) -> None:
    for package in packages(folder):
        assert package["integrity"].startswith("sha512-")
        assert package["tarball"].startswith(f"{package['name']}/-/")
        assert "://" not in package["tarball"]
        assert package["licence"]
        assert any(name.startswith("LICENSES/") for name in package["sha256"])


def test_the_sprite_keeps_each_icons_shapes() -> None:
    one = '<!-- x -->\n<svg class="a"\n viewBox="0 0 24 24">\n  <path d="M1 2" />\n</svg>\n'
    assert sprite({"dot": one}) == (
        '<svg xmlns="http://www.w3.org/2000/svg">\n'
        '<symbol id="dot" viewBox="0 0 24 24"><path d="M1 2" /></symbol>\n</svg>\n'
    )
