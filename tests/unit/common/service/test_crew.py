"""Worker processes: real ones, that die and hang."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TypeVar

import psutil
import pytest

from common import log
from common.bus import Poller
from common.service.crew import Crew, Failure
from tests.support import crew_jobs
from tests.support.hygiene import Place
from tests.support.stack import wait_for

pytestmark = pytest.mark.process
ENOUGH_S = 60.0
J = TypeVar("J")
R = TypeVar("R")


@pytest.fixture
def crew(place: Place) -> Iterator[Crew[str | int, int]]:
    with closing(Crew(crew_jobs.work, crew_jobs.prepare, (1000,), workers=2)) as made:
        yield made


def results(crew: Crew[J, R], count: int) -> dict[str, R | Failure]:
    """The next ``count`` results; the poller is woken for each."""
    got: dict[str, R | Failure] = {}
    poller = Poller(crew)

    def all_there() -> bool:
        poller.wait(1.0)
        got.update(crew.finished())
        return len(got) == count

    wait_for(all_there, ENOUGH_S, f"{count} results, not {got}")
    return got


@contextmanager
def held_open(fifo: Path) -> Iterator[None]:
    """Hold up who reads it, once somebody does."""
    opened: list[int] = []

    def is_read() -> bool:
        with suppress(OSError):  # ENXIO: nobody reads yet
            opened.append(os.open(fifo, os.O_WRONLY | os.O_NONBLOCK))
        return bool(opened)

    wait_for(is_read, ENOUGH_S, "the worker's beginning")
    yield
    os.close(opened[0])


@contextmanager
def four_waiting(crew: Crew[str | int, int], folder: Path) -> Iterator[None]:
    """Give ``job-0`` to ``job-3`` to a crew whose one worker is held up by ``at-hand`` meanwhile."""
    os.mkfifo(folder / "pipe")
    crew.submit("at-hand", f"until {folder / 'pipe'}")
    with held_open(folder / "pipe"):
        for number in range(4):
            crew.submit(f"job-{number}", number)
        yield


def test_each_job_has_one_result(crew: Crew[str | int, int]) -> None:
    for number in range(20):
        crew.submit(f"job-{number}", number)
    assert crew.busy == 20
    assert results(crew, 20) == {f"job-{number}": 1000 + number for number in range(20)}
    assert (crew.busy, crew.replaced, list(crew.finished())) == (0, 0, [])


def test_jobs_and_results_that_no_pipe_holds_get_through(place: Place) -> None:
    large = bytes(400_000)
    with closing(Crew(crew_jobs.give_back, crew_jobs.prepare, (0,))) as crew:
        for number in range(4):
            crew.submit(str(number), large, first=number == 3)
        assert results(crew, 4) == dict.fromkeys("0123", large)


def test_further_workers_start_when_jobs_wait_and_stay(crew: Crew[str | int, int]) -> None:
    (first,) = crew.pids
    crew.submit("job", 1)
    results(crew, 1)
    assert crew.pids == (first,), "one is enough"
    for number in range(8):
        crew.submit(f"job-{number}", number)
    results(crew, 8)
    assert len(crew.pids) == 2
    assert crew.pids[0] == first


def test_what_is_urgent_is_next_after_the_job_at_hand(place: Place, tmp_path: Path) -> None:
    with closing(Crew(crew_jobs.work, crew_jobs.prepare, (1000,), workers=1)) as crew:
        with four_waiting(crew, tmp_path):
            for number in (10, 11):
                crew.submit(f"urgent-{number}", number, first=True)
        order = list(results(crew, 7))
    # The second urgent one is sent when there is room for it: the worker may have begun its next job by then.
    assert order[:2] == ["at-hand", "urgent-10"]
    assert order.index("urgent-11") in (2, 3)
    assert [key for key in order if key.startswith("job")] == ["job-0", "job-1", "job-2", "job-3"]


def test_a_job_that_waits_can_be_made_urgent(place: Place, tmp_path: Path) -> None:
    with closing(Crew(crew_jobs.work, crew_jobs.prepare, (1000,), workers=1)) as crew:
        with four_waiting(crew, tmp_path):
            for key in ("job-3", "at-hand", "nobody"):
                crew.hurry(key)
        assert list(results(crew, 5)) == ["at-hand", "job-3", "job-0", "job-1", "job-2"]


def test_workers_are_niced_but_for_what_is_urgent(place: Place) -> None:
    own = os.getpriority(os.PRIO_PROCESS, 0)
    with closing(Crew(crew_jobs.work, crew_jobs.prepare, (0,), nice=5)) as crew:
        crew.submit("ordinary", "nice")
        crew.submit("urgent", "nice", first=True)
        crew.submit("its start", "nice at first")
        niced = min(own + 5, 19)
        assert results(crew, 3) == {"ordinary": niced, "urgent": own, "its start": niced}


def test_a_bug_costs_its_job_and_no_worker(crew: Crew[str | int, int]) -> None:
    crew.submit("bad", "bug")
    crew.submit("good", 1)
    got = results(crew, 2)
    assert got["good"] == 1001
    bad = got["bad"]
    assert isinstance(bad, Failure)
    assert (bad.fault, "ValueError: no such number" in bad.what) == ("exception", True)
    assert crew.replaced == 0


def test_a_job_that_kills_its_workers_is_given_up_and_no_other(crew: Crew[str | int, int]) -> None:
    for number in range(5):
        crew.submit(f"before-{number}", number)
    crew.submit("poison", "die")
    for number in range(5, 10):
        crew.submit(f"after-{number}", number)
    got = results(crew, 11)
    poison = got.pop("poison")
    assert isinstance(poison, Failure)
    assert poison.fault == "died"
    assert sorted(item for item in got.values() if isinstance(item, int)) == [1000 + number for number in range(10)]
    assert crew.replaced == 3


def test_a_job_whose_worker_was_killed_by_others_is_done_again(crew: Crew[str | int, int], tmp_path: Path) -> None:
    crew.submit("unlucky", f"once {tmp_path / 'mark'}")
    assert results(crew, 1) == {"unlucky": 1000}
    assert crew.replaced == 1


def test_an_urgent_job_whose_worker_was_killed_is_done_again_before_the_others(
    crew: Crew[str | int, int], tmp_path: Path
) -> None:
    for number in range(4):
        crew.submit(f"job-{number}", number)
    crew.submit("unlucky", f"once {tmp_path / 'mark'}", first=True)
    assert results(crew, 5) == {"unlucky": 1000} | {f"job-{number}": 1000 + number for number in range(4)}
    assert crew.replaced == 1


def test_an_urgent_job_is_not_blamed_for_the_one_that_was_begun_before_it(place: Place, tmp_path: Path) -> None:
    fifos = [tmp_path / name for name in ("first", "second")]
    for fifo in fifos:
        os.mkfifo(fifo)
    with closing(Crew(crew_jobs.work, crew_jobs.prepare, (1000,), deaths=1)) as crew:
        for fifo in fifos:
            crew.submit(fifo.name, f"until {fifo}")
        with held_open(fifos[0]):
            pass
        with held_open(fifos[1]):  # the first has ended, which the crew hasn't heard yet
            crew.submit("urgent", 5, first=True)
            os.kill(crew.pids[0], signal.SIGKILL)
            got = results(crew, 3)
    assert (got["first"], got["urgent"]) == (1000, 1005)
    assert got["second"] == Failure("died", "its worker died, 1 times")


def test_a_worker_that_hangs_is_killed(place: Place) -> None:
    with closing(Crew(crew_jobs.work, crew_jobs.prepare, (0,), deaths=2, limit_s=1.5)) as crew:
        crew.submit("stuck", "hang")
        crew.submit("next", 7)
        got = results(crew, 2)
        assert got["next"] == 7
        assert isinstance(got["stuck"], Failure)
        assert got["stuck"].fault == "hung"
        assert crew.replaced >= 2


def test_an_idle_worker_that_is_killed_is_replaced(crew: Crew[str | int, int]) -> None:
    crew.submit("job", 1)
    results(crew, 1)
    for number in range(8):
        crew.submit(str(number), "pid")
    results(crew, 8)
    before = crew.pids
    os.kill(before[0], signal.SIGKILL)
    wait_for(lambda: list(crew.finished()) == [] and crew.replaced and len(crew.pids) == 2, ENOUGH_S, "a new worker")
    assert before[0] not in crew.pids
    crew.submit("job", 5)
    assert results(crew, 1) == {"job": 1005}


@pytest.mark.parametrize("urgent", [False, True])
def test_workers_that_cannot_start_cost_the_job_and_do_not_start_for_ever(urgent: bool, place: Place) -> None:
    with closing(Crew(crew_jobs.work, crew_jobs.refuse_to_start, (0,))) as crew:
        wait_for(lambda: list(crew.finished()) == [] and crew.replaced == 1, ENOUGH_S, "the first to die")
        assert crew.pids == ()
        crew.submit("job", 1, first=urgent)
        got = results(crew, 1)
        assert isinstance(got["job"], Failure)
        assert crew.replaced <= 4


def test_close_ends_busy_and_idle_workers_twice(place: Place) -> None:
    crew: Crew[str | int, int] = Crew(crew_jobs.work, crew_jobs.prepare, (0,), workers=2)
    crew.submit("one", 1)
    results(crew, 1)
    for number in range(4):
        crew.submit(f"stuck-{number}", "hang")
    pids = crew.pids
    assert len(pids) == 2
    crew.close()
    crew.close()
    assert not any(psutil.pid_exists(pid) for pid in pids)


def test_a_worker_logs_for_its_service_at_the_level_of_the_moment(
    place: Place, capfd: pytest.CaptureFixture[str]
) -> None:
    log.setup("test.0", "info")
    lines: list[dict[str, object]] = []

    def told() -> bool:
        lines.extend(json.loads(line) for line in capfd.readouterr().err.splitlines())
        return any(line["event"] == "worker.job" for line in lines)

    try:
        with closing(Crew(crew_jobs.work, crew_jobs.prepare, (1000,))) as crew:
            crew.submit("quiet", 1)
            results(crew, 1)
            log.set_level("debug")
            crew.submit("told", 2)
            results(crew, 1)
            wait_for(told, ENOUGH_S, "the worker's line")
    finally:
        log.shutdown()
    assert [(line["service"], line["job"]) for line in lines if line["event"] == "worker.job"] == [("test.0", "told")]
