"""The last steps for a frame that is kept: exact corners, poses, erasing. Runs in a worker process, niced.

The worker gets a job by value and the pixels by the slot of a sample ring, in which it erases in place.
"""

from __future__ import annotations

import ctypes
import os
import signal
from collections.abc import Iterable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context

import cv2

from common.config import Rig
from common.frames import SampleSlots
from common.geometry import CameraModel
from common.labels import CameraLabel, Erased, LeftOut, Missing, ObjectLabel
from common.log import get
from common.messages import DetectedMarker
from services.label.covering import covering
from services.label.inpaint import erase
from services.label.labelling import Around, Labeller
from services.label.occlusion import DepthPicture
from services.label.regions import regions_on_sides

_NICE = 10
_PR_SET_PDEATHSIG = 1
_RETRIES = 3


@dataclass(frozen=True)
class Job:
    """A frame to finish; its pixels lie in ``slot`` of the sample ring ``ring``, ``around`` it is what is known."""

    key: str
    ring: str
    slot: int
    camera: CameraLabel
    markers: tuple[DetectedMarker, ...]
    around: Around
    depth_unit_mm: float | None = None


@dataclass(frozen=True)
class Finished:
    """What became of a job: the exact labels, what was erased, and what the rig says is to be kept nevertheless."""

    objects: tuple[ObjectLabel, ...]
    left_out: tuple[LeftOut, ...]
    missing: tuple[Missing, ...]
    inpainted: Erased
    keep_ambiguous: bool
    keep_incomplete: bool


class Finisher:
    """A pool of worker processes; one that dies is replaced and its jobs are done again.

    The workers get the rig by value: one that is replaced must not read a file that was edited meanwhile.
    """

    def __init__(self, rig: Rig, workers: int = 1) -> None:
        self._rig = rig
        self._workers = workers
        self._running: dict[str, tuple[Job, Future[Finished], int]] = {}
        self._pool = self._new_pool()
        self.restarts = 0

    def _new_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(
            self._workers, get_context("spawn"), initializer=_prepare, initargs=(self._rig, os.getpid())
        )

    def warm_up(self) -> None:
        """Start the workers now, so that the first record doesn't wait for an interpreter to start."""
        for _ in range(self._workers):
            self._pool.submit(os.getpid)

    @property
    def busy(self) -> int:
        """Jobs that are not finished."""
        return len(self._running)

    def submit(self, job: Job, attempt: int = 1) -> None:
        """Begin a job."""
        try:
            future = self._pool.submit(_finish, job)
        except BrokenProcessPool:
            self._replace_pool()
            future = self._pool.submit(_finish, job)
        self._running[job.key] = (job, future, attempt)

    def finished(self) -> Iterable[tuple[Job, Finished | None]]:
        """Jobs that ended since the last call; None where the job failed (the reason is in the log)."""
        for key, (job, future, attempt) in list(self._running.items()):
            if not future.done():
                continue
            del self._running[key]
            try:
                yield job, future.result()
            except BrokenProcessPool:
                self._replace_pool()
                if attempt < _RETRIES:
                    self.submit(job, attempt + 1)
                else:
                    get().error("finish.failed", sample=key, reason=f"its worker died {attempt} times")
                    yield job, None
            except Exception:  # noqa: BLE001 - a bug in one frame is logged and costs that frame, not the service
                get().exception("finish.failed", sample=key)
                yield job, None

    def _replace_pool(self) -> None:
        if getattr(self._pool, "_broken", False):
            self.restarts += 1
            get().warning("finish.worker_died", restarts=self.restarts)
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = self._new_pool()

    def reload(self, rig: Rig) -> None:
        """Take over another rig; jobs under way end with the old one."""
        self._rig = rig
        self._pool.shutdown(wait=False)
        self._pool = self._new_pool()
        self.warm_up()

    def close(self) -> None:
        """End the workers; jobs that have not begun are dropped."""
        self._pool.shutdown(wait=True, cancel_futures=True)


class _Worker:
    """State of a worker process: the labeller and the rings it has mapped."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.labeller = Labeller.of(rig)
        self.rings: dict[str, SampleSlots] = {}

    def slots(self, ring: str) -> SampleSlots:
        if ring not in self.rings:
            self.rings[ring] = SampleSlots(ring, writable=True)
            while len(self.rings) > 16:
                self.rings.pop(next(iter(self.rings))).close()
        return self.rings[ring]


_worker: _Worker | None = None


def _prepare(rig: Rig, parent: int) -> None:
    """Make this process a worker: low priority, one thread, gone with its parent, deaf to its group's signals."""
    global _worker
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
    os.setpgid(0, 0)
    os.nice(_NICE)
    cv2.setNumThreads(1)
    _worker = _Worker(rig)


def _finish(job: Job) -> Finished:
    assert _worker is not None
    options = _worker.rig.config.inpaint
    camera = CameraModel.from_label(job.camera)
    pixels = _worker.slots(job.ring).view(job.slot)
    bgr = pixels.bgr
    depth = None
    if pixels.depth is not None and job.depth_unit_mm is not None:
        depth = DepthPicture(pixels.depth, job.depth_unit_mm)
    labelled = _worker.labeller.label_once(job.markers, camera, bgr, job.around, depth)
    boxes = _worker.labeller.boxes
    found = regions_on_sides(labelled.objects, labelled.left_out, boxes, camera, margin=options.margin)
    covered = None if depth is None else covering(found, depth)
    erase(bgr, found, method=options.method, radius_px=options.radius_px, covered=covered)
    polygons = tuple(region.polygon for region in found)
    erased = Erased(method=options.method, margin=f"{options.margin:g} of the marker, at least 3 px", polygons=polygons)
    return Finished(
        objects=labelled.objects,
        left_out=labelled.left_out,
        missing=labelled.missing,
        inpainted=erased,
        keep_ambiguous=_worker.rig.config.pose.ambiguous == "keep",
        keep_incomplete=_worker.rig.config.record.incomplete == "keep",
    )
