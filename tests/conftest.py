"""Fixtures for all tests; process hygiene lives in tests/support."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def testdata() -> Callable[[str], Path]:
    """Path of a file below the shared test data; skips where it is missing, fails when CI=true."""
    folder = Path(os.environ.get("TAGMILL_TESTDATA", ROOT.parent / "shared" / "data"))

    def find(relative: str) -> Path:
        path = folder / relative
        if not path.exists():
            reason = f"test data {relative} is not in {folder} (set TAGMILL_TESTDATA)"
            if os.environ.get("CI") == "true":
                pytest.fail(reason)
            pytest.skip(reason)
        return path

    return find
