"""Fixtures for all tests; process hygiene lives in tests/support."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from tests.support.hygiene import Place, own_place
from tests.support.stack import ServiceProcess, Stack

ROOT = Path(__file__).resolve().parents[1]
LONG_S = 900

# A property doesn't fail because the machine is slow just now.
settings.register_profile("tagmill", deadline=None)
settings.load_profile("tagmill")

# A shell ignores Ctrl-C for what it starts in the background (`make test &`), and children inherit that; the programs
# under test are started as from a terminal.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


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


@pytest.fixture(autouse=True)
def place(monkeypatch: pytest.MonkeyPatch) -> Iterator[Place]:
    """A prefix and a run folder for this test alone; fails it if it leaves something behind."""
    with own_place(monkeypatch) as own:
        yield own


@pytest.fixture
def stack(place: Place, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Stack]:
    """Starts real processes, stops what still runs at the end, shows their logs if the test failed."""
    made = Stack(place, tmp_path)
    try:
        yield made
    finally:
        stubborn = made.close()
        report = getattr(request.node, "call_report", None)
        if stubborn or (report is not None and report.failed):
            print(made.logs())
    if stubborn:
        pytest.fail(f"these did not stop when asked: {stubborn}", pytrace=False)


@pytest.fixture
def start_service(stack: Stack) -> Callable[..., ServiceProcess]:
    """``start_service(name, rig, *arguments)``: a real service process."""
    return stack.start_service


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Tests that share a stack on one worker: those of tests/browser, those of one class; any other wherever is room.

    xdist's own `--dist loadgroup` has no effect with pytest 9.2, which doesn't let it rename tests.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Together(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            if nodeid.startswith("tests/browser/"):
                return "tests/browser"
            file, *names = nodeid.split("::")
            return "::".join((file, *names[:1])) if len(names) > 1 else nodeid

    return Together(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A long run may take a quarter of an hour on a busy machine, where it names no limit of its own.

    The longest come first: an hour's soak at the end would be an hour in which nothing else is left to do.
    """
    limits: dict[pytest.Item, float] = {}
    for item in items:
        if item.get_closest_marker("long"):
            if not item.get_closest_marker("timeout"):
                item.add_marker(pytest.mark.timeout(LONG_S))
            timeout = item.get_closest_marker("timeout")
            assert timeout is not None
            limits[item] = timeout.args[0]
    items.sort(key=lambda item: limits.get(item, 0.0), reverse=True)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
    """Let fixtures see whether their test failed."""
    report = yield
    if report.when == "call":
        item.call_report = report  # type: ignore[attr-defined]
    return report
