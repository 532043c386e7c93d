"""A bus for each test, in the test's own process unless it says otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing

import pytest

from common.bus import Endpoints, Proxy
from common.config.models import NetworkConfig
from tests.support.bus import Bus
from tests.support.hygiene import Place


@pytest.fixture
def endpoints(place: Place) -> Endpoints:
    made = Endpoints.of(NetworkConfig())
    made.prepare()
    return made


@pytest.fixture
def proxy(endpoints: Endpoints) -> Iterator[Proxy]:
    with closing(Proxy(endpoints)) as made:
        made.start()
        yield made


@pytest.fixture
def bus(endpoints: Endpoints) -> Iterator[Bus]:
    with ExitStack() as closers:
        yield Bus(endpoints, closers)
