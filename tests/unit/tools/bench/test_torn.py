"""The stress of a ring with checksums, for a moment; `tagmill bench torn` does it for ten minutes."""

from __future__ import annotations

import pytest

from tools.bench.torn import UNGUARDED, stress


@pytest.mark.process
@pytest.mark.timeout(400)
def test_readers_of_any_speed_are_never_given_wrong_pixels() -> None:
    written, readings = stress(1.5)
    guarded = [one for one in readings if one.reader != UNGUARDED]
    assert written > 0
    assert len(guarded) == 3
    assert [one for one in guarded if one.torn] == []
    assert all(one.whole + one.lost > 0 for one in guarded)


@pytest.mark.long
@pytest.mark.process
@pytest.mark.timeout(400)
def test_the_stress_would_have_met_torn_frames() -> None:
    _, readings = stress(60.0)
    assert [one.reader for one in readings if one.torn] == [UNGUARDED]
