"""Work beside the loop: a thread for the disk, and the way its results come back into the loop."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

T = TypeVar("T")
_ADD_ONE = (1).to_bytes(8, "little")


class Completions:
    """Futures' callbacks, run in the loop's thread. ``fileno`` becomes readable when there is one to run."""

    def __init__(self) -> None:
        self._done: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._lock = threading.Lock()
        self._closed = False

    def fileno(self) -> int:
        """The descriptor to wait on."""
        return self._wake

    def watch(self, future: Future[T], then: Callable[[Future[T]], None]) -> None:
        """Call ``then(future)`` in the loop's thread once it is done."""
        future.add_done_callback(lambda done: self._put(lambda: then(done)))

    def run(self) -> None:
        """Call what is due; never waits."""
        try:
            os.eventfd_read(self._wake)
        except BlockingIOError:
            return
        while True:
            try:
                call = self._done.get_nowait()
            except queue.Empty:
                return
            call()

    def close(self) -> None:
        """What finishes from now on is not heard; idempotent."""
        with self._lock:
            if not self._closed:
                self._closed = True
                os.close(self._wake)

    def _put(self, call: Callable[[], None]) -> None:
        self._done.put(call)
        with self._lock:  # so that the number of a closed descriptor, perhaps another file's by now, isn't written to
            if not self._closed:
                os.write(self._wake, _ADD_ONE)


class DiskThread:
    """One thread that does what may block on the disk, in order.

    A daemon thread: stuck in a dead disk it can't keep the process from ending.
    """

    def __init__(self, completions: Completions, name: str = "store-disk") -> None:
        self._completions = completions
        self._jobs: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def submit(self, job: Callable[[], T], then: Callable[[Future[T]], None]) -> None:
        """Do ``job`` in the thread, then ``then`` in the loop with its future."""
        future: Future[T] = Future()
        self._completions.watch(future, then)
        self._jobs.put((future, job))

    def close(self, limit_s: float) -> bool:
        """End after the jobs at hand; False if the thread is still stuck after ``limit_s``."""
        self._jobs.put(None)
        self._thread.join(limit_s)
        return not self._thread.is_alive()

    def _work(self) -> None:
        while (item := self._jobs.get()) is not None:
            future, job = item
            try:
                result = job()
            except BaseException as error:  # noqa: BLE001 - handed on: whoever asked gets it from the future
                future.set_exception(error)
            else:
                future.set_result(result)
