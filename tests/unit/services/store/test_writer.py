"""The worker pool with real worker processes and a real sample ring."""

import multiprocessing
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from common import log
from common.bus import Poller
from common.dataset import FOLDERS
from common.frames import SampleRing, segment_name
from services.store.background import Completions, DiskThread
from services.store.worker import WriteJob, Written
from services.store.writer import Writer
from tests.support.hygiene import Place
from tests.support.samples import HEIGHT, WIDTH, check_whole, label_for, pixels

DEADLINE_S = 30.0


class Loop:
    """A service's loop around a writer."""

    def __init__(self, folder: Path, place: Place, delay_s: float, workers: int) -> None:
        self.writer = Writer(log.get(), reserve=0, delay_s=delay_s, workers=workers)
        self.ring = SampleRing(segment_name(place.prefix, "label.0", "boot"), WIDTH, HEIGHT, True, 8)
        self.folder = folder
        self.results: dict[str, Written] = {}

    def submit(self, frame: int, ring: str | None = None, *, first: bool = False) -> str:
        slot = self.ring.acquire()
        assert slot is not None
        view = self.ring.view(slot)
        view.bgr[:], view.depth[:] = pixels(frame)
        label = label_for(frame)
        job = WriteJob(self.folder, label, ring or self.ring.name, slot)
        self.writer.submit(job, lambda written: self.results.__setitem__(label.sample, written), first=first)
        return label.sample

    def run_until(self, done: Callable[[], bool]) -> None:
        poller = Poller(self.writer)
        deadline = time.monotonic() + DEADLINE_S
        while not done():
            assert time.monotonic() < deadline, "waited in vain"
            poller.wait(0.1)
            self.writer.collect()

    def close(self) -> None:
        self.writer.close()
        self.ring.close()


@pytest.fixture
def make_loop(tmp_path: Path, place: Place) -> Iterator[Callable[[float], Loop]]:
    made: list[Loop] = []
    for name in FOLDERS:
        (tmp_path / "session" / name).mkdir(parents=True)
    (tmp_path / "session/session.json").write_text("{}")

    def make(delay_s: float = 0.0, workers: int = 2) -> Loop:
        made.append(Loop(tmp_path / "session", place, delay_s, workers))
        return made[-1]

    yield make
    for loop in made:
        loop.close()


def test_what_is_urgent_is_written_before_all_that_waits(make_loop: Callable[..., Loop]) -> None:
    loop = make_loop(workers=1)
    ordinary = [loop.submit(frame) for frame in range(5)]
    urgent = loop.submit(5, first=True)
    loop.run_until(lambda: len(loop.results) == 6)
    order = list(loop.results)
    assert order.index(urgent) <= 2, "only what the worker had begun goes before it"
    assert [sample for sample in order if sample != urgent] == ordinary


def test_more_jobs_than_workers_are_all_written(make_loop: Callable[..., Loop]) -> None:
    loop = make_loop()
    samples = [loop.submit(frame) for frame in range(8)]
    assert loop.writer.backlog == 8
    loop.run_until(lambda: len(loop.results) == 8)
    assert all(loop.results[sample].error is None and loop.results[sample].bytes for sample in samples)
    assert loop.writer.backlog == 0
    check_whole(loop.folder, *samples)


def test_a_killed_worker_is_replaced_and_its_jobs_are_done_again(make_loop: Callable[..., Loop]) -> None:
    loop = make_loop(0.3)
    samples = [loop.submit(frame) for frame in range(6)]
    loop.run_until(lambda: len(loop.results) >= 1)
    multiprocessing.active_children()[0].kill()
    loop.run_until(lambda: len(loop.results) == 6)
    assert all(loop.results[sample].error is None for sample in samples)
    assert loop.writer.replaced == 1
    check_whole(loop.folder, *samples)


def test_a_job_that_kills_each_worker_is_given_up(make_loop: Callable[..., Loop]) -> None:
    loop = make_loop(60.0)
    sample = loop.submit(1)

    def kill() -> bool:
        for child in multiprocessing.active_children():
            child.kill()
        return bool(loop.results)

    loop.run_until(kill)
    error = loop.results[sample].error
    assert error is not None
    assert error.code == "worker_died"


def test_a_ring_that_is_gone_and_a_slot_that_never_was(make_loop: Callable[..., Loop]) -> None:
    loop = make_loop()
    samples = [loop.submit(1, "tagmill-x-label.0-gone"), loop.submit(2, "../../etc/passwd")]
    loop.run_until(lambda: len(loop.results) == 2)
    for sample in samples:
        error = loop.results[sample].error
        assert error is not None
        assert error.code == "pixels_gone"


def test_closing_while_a_worker_writes_does_not_wait_for_it(make_loop: Callable[..., Loop]) -> None:
    loop = make_loop(60.0)
    for frame in range(1, 4):
        loop.submit(frame)
    loop.run_until(lambda: len(multiprocessing.active_children()) == 2)
    loop.close()
    assert multiprocessing.active_children() == []


def test_results_come_in_the_loops_thread_and_errors_too() -> None:
    completions = Completions()
    disk = DiskThread(completions)
    seen: list[object] = []
    disk.submit(lambda: 1 // 0, lambda done: seen.append(type(done.exception())))
    disk.submit(lambda: "done", lambda done: seen.append(done.result()))
    poller = Poller(completions)
    deadline = time.monotonic() + DEADLINE_S
    while len(seen) < 2:
        assert time.monotonic() < deadline
        assert poller.wait(5)
        completions.run()
    assert seen == [ZeroDivisionError, "done"]
    assert not poller.wait(0)
    assert disk.close(5)
    completions.close()
    completions.close()
