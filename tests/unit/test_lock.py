"""``requirements.lock`` pins everything that a set-up installs, also what is only asked for by others."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]


def pinned() -> dict[str, str]:
    lines = (ROOT / "requirements.lock").read_text().split()
    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+==[A-Za-z0-9_.+!-]+", line) for line in lines)
    return {canonicalize_name(line.partition("==")[0]): line.partition("==")[2] for line in lines}


def extras_of_setup() -> set[str]:
    found = re.search(r"^EXTRAS := (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert found is not None
    return set(found[1].split(","))


def needed(name: str, extras: set[str], seen: set[tuple[str, str]]) -> set[str]:
    """Every package that this one brings, in this environment; one that isn't installed is named, not entered."""
    out: set[str] = set()
    try:
        wanted = distribution(name).requires or []
    except PackageNotFoundError:
        return out
    for text in wanted:
        requirement = Requirement(text)
        applies = requirement.marker is None or any(
            requirement.marker.evaluate({"extra": one}) for one in ("", *extras)
        )
        key = (canonicalize_name(requirement.name), ",".join(sorted(requirement.extras)))
        if applies and key not in seen:
            seen.add(key)
            out |= {key[0]} | needed(requirement.name, set(requirement.extras), seen)
    return out


def test_everything_that_make_setup_installs_is_pinned() -> None:
    lock = pinned()
    wanted = needed("tagmill", extras_of_setup(), set())
    assert len(wanted) > 40
    assert wanted - lock.keys() == set()


def test_what_is_pinned_fits_what_is_asked_for() -> None:
    lock = pinned()
    for text in distribution("tagmill").requires or []:
        requirement = Requirement(text)
        version = lock.get(canonicalize_name(requirement.name))
        if version is not None:
            assert requirement.specifier.contains(version, prereleases=True), text
