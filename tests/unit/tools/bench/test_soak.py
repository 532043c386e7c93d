"""What counts as growth in a soak."""

import pytest

from tools.bench.soak import SLOPE_OVER_S, Growth, Soaked, slope

LOOKS = 100


def growth(memory_mb: list[float], processes: list[int], seconds: float = 2 * SLOPE_OVER_S) -> Growth:
    at_s = [seconds * look / (LOOKS - 1) for look in range(LOOKS)]
    return Growth(memory_mb=memory_mb, descriptors=[20] * LOOKS, processes=processes, at_s=at_s)


def complaints(one: Growth) -> list[str]:
    one.mb_per_hour = slope(one)
    return Soaked(1.0, 1, {"store": one}, (4, 4), []).complaints


def test_what_grows_is_told() -> None:
    ramp = growth([100 + 0.1 * look for look in range(LOOKS)], [3] * LOOKS)
    assert slope(ramp) == pytest.approx(0.1 * (LOOKS - 1) / (2 * SLOPE_OVER_S) * 3600, rel=0.01)
    assert complaints(ramp) == [f"the memory of store grows by {slope(ramp):.1f} MB an hour"]


def test_a_worker_more_is_no_growth_but_what_grows_after_it_is() -> None:
    begun = [2 if look < 20 else 3 for look in range(LOOKS)]
    assert complaints(growth([50.0 * count for count in begun], begun)) == []
    after = [50.0 * count + (0.2 * look if count == 3 else 0) for look, count in enumerate(begun)]
    assert complaints(growth(after, begun)) != []


def test_a_short_time_says_nothing() -> None:
    ramp = [100.0 + look for look in range(LOOKS)]
    assert slope(growth(ramp, [3] * LOOKS, SLOPE_OVER_S / 2)) is None
    assert slope(growth(ramp, [2] * 80 + [3] * 20)) is None
