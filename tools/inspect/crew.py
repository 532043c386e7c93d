"""Looking at many samples on all cores, with a progress bar."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

import cv2
from rich.console import Console
from rich.progress import Progress

from common.errors import DatasetError
from tools.inspect.facts import Facts
from tools.inspect.measure import Inspector, Job

_ALONE = 8
"""So few samples are looked at before a second process has started."""
_inspector: Inspector | None = None


def look_at(job: Job, samples: Sequence[str], *, quiet: bool) -> list[Facts]:
    """The facts of all samples, in their order; raises DatasetError if a worker process dies (memory is short)."""
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=quiet or not console.is_terminal) as progress:
        task = progress.add_task("looking at samples", total=len(samples))
        found: list[Facts] = []
        cores = min(len(os.sched_getaffinity(0)), -(-len(samples) // _ALONE))
        if cores < 2:
            inspector = Inspector(job)
            for sample in samples:
                found.append(inspector.look(sample))
                progress.advance(task)
            return found
        pool = ProcessPoolExecutor(cores, get_context("spawn"), _prepare, (job,))
        try:
            for facts in pool.map(_look, samples, chunksize=4):
                found.append(facts)
                progress.advance(task)
        except BrokenProcessPool as error:
            raise DatasetError(
                f"a process that looked at {job.folder} was killed; is memory short? nothing was changed"
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)
        return found


def _prepare(job: Job) -> None:
    global _inspector
    cv2.setNumThreads(1)
    _inspector = Inspector(job)


def _look(sample: str) -> Facts:
    assert _inspector is not None
    return _inspector.look(sample)
