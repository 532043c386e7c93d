"""`tagmill bench soak`, shortened: no process takes descriptors and segments that it doesn't give back."""

from __future__ import annotations

import json
import os

import pytest

from tests.support.supervised import run_module

pytestmark = pytest.mark.process


def soak(minutes: float, timeout_s: float) -> dict[str, object]:
    _, done = run_module("tools", "bench", "soak", "--minutes", str(minutes), "--json", timeout_s=timeout_s)
    assert done.returncode == 0, done.stdout + done.stderr
    plain: dict[str, object] = json.loads(done.stdout)
    return plain


@pytest.mark.timeout(400)
def test_a_short_soak_takes_nothing_for_good() -> None:
    soaked = soak(0.06, 380)
    assert soaked["complaints"] == []
    assert soaked["samples"] != 0
    assert {"control", "store", "label.0", "detect.0", "capture.cam0", "capture.cam1"} <= set(soaked["services"])  # type: ignore[call-overload]


@pytest.mark.long
@pytest.mark.timeout(8000)
def test_a_long_soak_keeps_its_memory() -> None:
    """An hour by default; TAGMILL_SOAK_MINUTES says how long."""
    minutes = float(os.environ.get("TAGMILL_SOAK_MINUTES", "60"))
    assert soak(minutes, minutes * 60 + 600)["complaints"] == []
