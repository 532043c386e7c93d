"""Samples on their way: sample ring → worker (exact labels, erasing) → store → durable.

A sample holds its slot from the copying of its pixels to the store's answer: as many slots, as many may wait. Nothing
leaves this table without an outcome. A single request goes first: it has slots of its own and overtakes recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from common import clock, ids
from common.bus import OrderClient
from common.errors import NoSpaceError, RefusedError, TagmillError
from common.frames import FrameView, SampleRing, segment_name
from common.labels import CameraLabel, DepthLabel, Label, ObjectLabel, SourceDetections
from common.laps import Laps, StepMeans, Stopwatch
from common.log import get
from common.messages import Answer, Detections, FrameRef, StoreOrder
from services.label.cameras import Camera
from services.label.exact import Finished, versions
from services.label.finish import Finisher, Job
from services.label.held import Held, LookAround, Wait
from services.label.history import kept
from services.label.labelling import Around
from services.label.requests import Recording, Request, explain
from services.label.thinning import Thinning, reserved
from services.label.verdict import verdict

Taker = Request | Recording
Others = Callable[[FrameRef], tuple[SourceDetections, ...]]


@dataclass(eq=False)
class Sample:
    """A sample that isn't durable yet, and who asked for it."""

    name: str
    ref: FrameRef
    ring: SampleRing
    slot: int
    takers: list[Taker]
    urgent: bool
    camera: CameraLabel
    depth_unit_mm: float | None
    copied: Laps
    objects: tuple[ObjectLabel, ...] = ()

    @property
    def recording(self) -> str:
        """The recording it belongs to: a started one before a single request."""
        first = next((taker for taker in self.takers if isinstance(taker, Recording)), self.takers[0])
        return first.recording


@dataclass(frozen=True)
class Outcome:
    """What became of a sample: stored (``reason`` None), or refused with a reason and a sentence."""

    sample: Sample
    reason: str | None = None
    message: str | None = None


class Samples:
    """The table of samples under way, and the sample rings (one a camera and picture size)."""

    def __init__(self, prefix: str, owner: str, boot: str, slots: int, *, keep_original: bool) -> None:
        self._prefix, self._owner, self._boot = prefix, owner, boot
        self._slots = slots
        self.keep_original = keep_original
        self._rings: dict[str, SampleRing] = {}
        self._rings_made = 0
        self._thinnings: dict[str, Thinning] = {}
        self._held = Held()
        self.under_way: dict[str, Sample] = {}
        self.steps = StepMeans()

    def room(self, camera: str) -> bool:
        """Whether a slot is free for a recording on this camera (or its ring isn't made yet)."""
        return self._free(camera) > reserved(self._slots)

    def _free(self, camera: str) -> int:
        ring = self._rings.get(camera)
        return self._slots if ring is None else ring.free

    def begin(
        self,
        camera: Camera,
        detections: Detections,
        around: Around,
        takers: list[Taker],
        finisher: Finisher,
        wait: Wait | None = None,
    ) -> Sample:
        """Copy the frame into a slot and give it to a worker, or have it ``wait`` for the frames after it.

        Raises FrameLostError if the frame was overwritten meanwhile, and RefusedError: ``backlog_full``
        without a free slot, ``thinned`` if a recording must leave it out, ``no_space`` if shared memory has no room
        for a sample ring.
        """
        ref = detections.ref
        name = ids.sample_name(ref.captured_wall_ns, ref.camera, ref.frame)
        known = self.under_way.get(name)
        if known is not None:
            return self._join(known, takers, finisher)
        urgent = any(isinstance(taker, Request) for taker in takers)
        if not urgent:
            self._require_share(camera)
        watch = Stopwatch()
        ring, slot = self._keep_pixels(camera, ref)
        watch.lap("copy")
        state = camera.state
        sample = Sample(name, ref, ring, slot, takers, urgent, state.camera, state.depth_unit_mm, watch.laps)
        self.under_way[name] = sample
        job = Job(name, ring.name, slot, state.camera, detections.markers, around, state.depth_unit_mm)
        if wait is None:
            finisher.submit(job, first=urgent)
        else:
            self._held.add(job, wait)
        return sample

    def _require_share(self, camera: Camera) -> None:
        """Raise RefusedError if recordings must do without this frame. A paced camera waits instead (``room``)."""
        free = self._free(camera.name)
        if camera.state.paced:
            if not self.room(camera.name):
                raise RefusedError(explain("backlog_full"), code="backlog_full")
            return
        thinning = self._thinnings.setdefault(camera.name, Thinning(self._slots))
        before, taken = thinning.active, thinning.takes(free)
        if thinning.active is not before:
            get().warning("recording.thinned", camera=camera.name, begins=thinning.active, waiting=self._slots - free)
        if not taken:
            code = "thinned" if thinning.share(free) else "backlog_full"
            raise RefusedError(explain(code), code=code)

    @staticmethod
    def _join(sample: Sample, takers: list[Taker], finisher: Finisher) -> Sample:
        """Who asks for a frame that is on its way already shares the sample; a single request hurries it."""
        if sample.takers[0].background is not takers[0].background:
            raise RefusedError(explain("not_due"), code="not_due")
        sample.takers += takers
        if not sample.urgent and any(isinstance(taker, Request) for taker in takers):
            sample.urgent = True
            finisher.hurry(sample.name)
        return sample

    @property
    def waiting(self) -> bool:
        """Whether samples wait for the frames after them."""
        return len(self._held) > 0

    def go_on(self, look: LookAround, newest: Callable[[str], int], finisher: Finisher, *, all_: bool = False) -> None:
        """Give waiting samples whose objects were seen again (or ``all_``) to a worker."""
        for job in self._held.due(look, newest, clock.monotonic_ns(), all_=all_):
            finisher.submit(job, first=self.under_way[job.key].urgent)

    def _keep_pixels(self, camera: Camera, ref: FrameRef) -> tuple[SampleRing, int]:
        held: tuple[SampleRing, int] | None = None
        try:
            with camera.pixels(ref) as view:
                held = self._slot_for(camera.name, view)
                self._copy(view, *held)
        except BaseException:
            if held is not None:
                held[0].release(held[1])
            raise
        return held

    def _slot_for(self, camera: str, view: FrameView) -> tuple[SampleRing, int]:
        """A slot in the camera's sample ring, which is made at the first sample and anew for another size."""
        height, width = view.bgr.shape[:2]
        has_depth = view.depth is not None
        ring = self._rings.get(camera)
        wanted = (width, height, has_depth, self.keep_original)
        if ring is not None and _kind(ring) != wanted:
            if ring.free < self._slots:
                raise RefusedError(explain("backlog_full"), code="backlog_full")
            self._rings.pop(camera).close()
            ring = None
        if ring is None:
            self._rings_made += 1
            name = segment_name(self._prefix, f"{self._owner}.{camera}.{self._rings_made}", self._boot)
            try:
                ring = SampleRing(name, width, height, has_depth, self._slots, with_original=self.keep_original)
            except NoSpaceError as error:
                raise RefusedError(error.message, code="no_space") from error
            self._rings[camera] = ring
        try:
            slot = ring.acquire()
        except NoSpaceError as error:
            raise RefusedError(error.message, code="no_space") from error
        if slot is None:
            raise RefusedError(explain("backlog_full"), code="backlog_full")
        return ring, slot

    @staticmethod
    def _copy(view: FrameView, ring: SampleRing, slot: int) -> None:
        kept = ring.view(slot)
        np.copyto(kept.bgr, view.bgr)
        if kept.depth is not None and view.depth is not None:
            np.copyto(kept.depth, view.depth)
        if kept.original is not None:
            np.copyto(kept.original, view.bgr)

    def finished(
        self, jobs: Iterable[tuple[Job, Finished | None]], session: str, store: OrderClient, others: Others
    ) -> Iterator[Outcome]:
        """Send what the workers have finished to the store; yields those that are refused instead.

        ``others`` gives what sources other than the markers have said of the frame by now.
        """
        for job, result in jobs:
            sample = self.under_way.get(job.key)
            if sample is None:
                continue
            if result is None:
                yield self._end(sample, "failed", None)
                continue
            self.steps.add(sample.copied | result.laps)
            refusal = verdict(result, background=sample.takers[0].background)
            if refusal is not None:
                yield self._end(sample, refusal.code, refusal.message)
                continue
            sample.objects = result.objects
            order = StoreOrder(
                key=sample.name,
                recording=sample.recording,
                camera=sample.ref.camera,
                ring=sample.ring.name,
                slot=sample.slot,
                label=_label(sample, job, result, session, others(sample.ref)),
                urgent=sample.urgent,
            )
            try:
                store.send(order)
            except TagmillError as error:
                yield self._end(sample, error.code, error.message)

    def answered(self, answer: Answer) -> Outcome | None:
        """The store's answer to a sample's order; None if the answer is to something else."""
        sample = self.under_way.get(answer.key)
        if sample is None:
            return None
        error = answer.error
        return self._end(sample, error.code if error else None, error.message if error else None)

    def _end(self, sample: Sample, reason: str | None, message: str | None) -> Outcome:
        del self.under_way[sample.name]
        sample.ring.release(sample.slot)
        return Outcome(sample, reason, message)

    def keep_only(self, cameras: Container[str]) -> None:
        """Remove the idle sample rings of all other cameras."""
        for name in [name for name in self._rings if name not in cameras]:
            if self._rings[name].free == self._slots:
                self._rings.pop(name).close()

    def close(self) -> None:
        """Remove the sample rings."""
        for ring in self._rings.values():
            ring.close()
        self._rings.clear()


def _kind(ring: SampleRing) -> tuple[int, int, bool, bool]:
    layout = ring.layout
    return layout.width, layout.height, layout.has_depth, layout.has_original


def _label(sample: Sample, job: Job, result: Finished, session: str, others: tuple[SourceDetections, ...]) -> Label:
    ref = sample.ref
    pairs = (taker.order.pair for taker in sample.takers if isinstance(taker, Request) and taker.order.pair)
    return Label(
        sample=sample.name,
        session=session,
        recording=sample.recording,
        camera=sample.camera,
        frame=ref.frame,
        boot=ref.boot,
        source_name=ref.source_name,
        captured_at=clock.iso_utc(ref.captured_wall_ns),
        captured_wall_ns=ref.captured_wall_ns,
        captured_mono_ns=ref.captured_mono_ns,
        device_ns=ref.device_ns,
        depth=None if sample.depth_unit_mm is None else DepthLabel(unit_mm=sample.depth_unit_mm),
        background=sample.takers[0].background,
        objects=result.objects,
        left_out=result.left_out,
        detections=others,
        inpainted=result.inpainted,
        complete=not result.missing,
        missing=result.missing,
        pair=next(pairs, None),
        made_from=kept(job.markers, job.around) if sample.ring.layout.has_original else None,
        versions=versions(),
    )
