"""The mapping of a camera's clock to the host's, on clocks whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from services.capture.device_clock import BUCKETS, DeviceClock, Stamper

LEAST_NS = 3_000_000
"""The least delay of a frame: nothing on the host can tell it from an offset."""
MS = 1_000_000


def frames(
    seconds: float, *, fps: float = 30.0, drift: float = 0.0, jitter_ms: float = 8.0, seed: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """When frames were taken (host), the device's stamps, when they arrived: ns; delays are mostly short, some long."""
    random = np.random.default_rng(seed)
    taken = 10_000_000_000 + (np.arange(int(seconds * fps)) / fps * 1e9).astype(np.int64)
    device = 77_000_000 + ((taken - taken[0]) * (1 - drift)).astype(np.int64)
    delay = LEAST_NS + (random.exponential(jitter_ms / 3, len(taken)) * MS).astype(np.int64)
    delay[random.random(len(taken)) < 0.02] += 60 * MS
    return taken, device, taken + delay


@pytest.mark.parametrize("drift", [0.0, 80e-6, -80e-6])
def test_jitter_is_taken_out_and_drift_followed(drift: float) -> None:
    taken, device, arrived = frames(120, drift=drift)
    clock = DeviceClock()
    mapped = np.array([clock.host_ns(int(at), int(came)) for at, came in zip(device, arrived, strict=True)])
    off_ms = (mapped - taken - LEAST_NS) / MS
    settled = off_ms[30 * 10 :]
    assert np.abs(settled).max() < 0.6
    assert np.abs(np.diff(mapped - taken)[300:]).max() < 0.5 * MS, "intervals are the device's, not the arrivals'"
    assert clock.drift == pytest.approx(drift, abs=15e-6)
    assert np.abs(arrived - taken - LEAST_NS).max() > 60 * MS, "which the arrivals are not"


def test_the_window_slides_so_that_a_change_of_the_least_delay_is_followed() -> None:
    _, device, arrived = frames(3 * BUCKETS, jitter_ms=0.5)
    half = len(device) // 2
    arrived[half:] += 20 * MS
    clock = DeviceClock()
    mapped = [clock.host_ns(int(at), int(came)) for at, came in zip(device, arrived, strict=True)]
    assert abs(mapped[half - 1] - arrived[half - 1]) < 5 * MS
    assert abs(mapped[-1] - arrived[-1]) < 5 * MS


@pytest.mark.parametrize("new_origin", [0, 10**15])
def test_a_clock_that_is_set_anew_is_mapped_anew(new_origin: int) -> None:
    taken, device, arrived = frames(20)
    device[300:] = device[300:] - device[300] + new_origin
    clock = DeviceClock()
    mapped = np.array([clock.host_ns(int(at), int(came)) for at, came in zip(device, arrived, strict=True)])
    assert np.abs((mapped - taken)[330:] - LEAST_NS).max() < 3 * MS


def test_wall_clock_sized_stamps_lose_nothing() -> None:
    clock = DeviceClock()
    origin = 1_800_000_000_000_000_000
    mapped = [clock.host_ns(origin + step * 33_333_333, 5 + step * 33_333_333) for step in range(600)]
    assert mapped == [5 + step * 33_333_333 for step in range(600)]


def test_stamps_are_never_of_the_future_and_never_run_backwards() -> None:
    for how in ("arrival", "device", "monotonic", "media"):
        stamper = Stamper()
        _, device, arrived = frames(10, drift=1e-3)
        stamps = [
            stamper.stamp(how, int(at), int(came))  # type: ignore[arg-type]
            for at, came in zip(device, np.maximum.accumulate(arrived), strict=True)
        ]
        assert (np.diff(stamps) >= 0).all()
        assert (np.array(stamps) <= np.maximum.accumulate(arrived)).all()


def test_who_stamps_how() -> None:
    assert Stamper().stamp("arrival", 5, 1_000) == 1_000
    assert Stamper().stamp("media", 5, 1_000) == 1_000
    assert Stamper().stamp("device", None, 1_000) == 1_000
    assert Stamper().stamp("monotonic", 400, 1_000) == 400
    assert Stamper().stamp("monotonic", 2_000, 1_000) == 1_000, "of the future: not that clock"
    assert Stamper().stamp("monotonic", 5, 90 * 10**9) == 90 * 10**9, "long ago: not that clock"
