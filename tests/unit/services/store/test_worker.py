"""The rings a worker maps, and how long: a dead one's memory is given back."""

from __future__ import annotations

import pytest

from common.errors import FrameLostError
from common.frames import SampleRing, segment_name
from services.store.worker import Rings
from tests.support.hygiene import Place


def ring(place: Place, boot: str) -> SampleRing:
    return SampleRing(segment_name(place.prefix, "label.0.cam0", boot), 64, 48, False, 2)


def test_rings_that_are_gone_give_way_to_a_new_one(place: Place) -> None:
    rings = Rings()
    with ring(place, "1") as first, ring(place, "2") as second, ring(place, "3") as third, ring(place, "4") as fourth:
        for made in (first, second, third):
            rings.slots(made.name, ())
        first.close()
        second.close()
        rings.slots(third.name, ())
        assert rings.names == (first.name, second.name, third.name)
        assert rings.slots(first.name, ()).view(1).bgr.shape == (48, 64, 3), "mapped: its pixels are still there"
        rings.slots(fourth.name, {second.name})
        assert rings.names == (second.name, third.name, fourth.name)
        with pytest.raises(FrameLostError):
            rings.slots(first.name, ())
    rings.close()
    assert rings.names == ()
