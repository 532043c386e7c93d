"""Decides what is recorded: requests and recordings meet labelled frames and the outcomes of samples."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator

from common import clock
from common.errors import FrameLostError, RefusedError
from common.ledgers import AutoLimits, CameraLedger
from common.log import get
from common.messages import (
    Answer,
    CameraState,
    Detections,
    ErrorInfo,
    FrameRef,
    LedgerOrder,
    RecordingState,
    RecordOrder,
    StartOrder,
)
from services.label.account import Account
from services.label.auto import Auto, Measure
from services.label.labelling import Labelled
from services.label.ledgers import Ledgers
from services.label.requests import Recording, Request, explain
from services.label.samples import Outcome, Taker

_END_GRACE_NS = 2_000_000_000
_REMEMBER_ENDED_NS = 10_000_000_000
_ANSWERS_KEPT = 1000

Begin = Callable[[Detections, list[Taker]], str]
"""Starts a sample and returns its name; raises FrameLostError or RefusedError."""


class Recorder:
    """All requests and recordings of the cameras of one label process."""

    def __init__(self, reply: Callable[[Answer], None], boot: str = "") -> None:
        self._reply = reply
        self._ledgers = Ledgers(boot)
        self._answered: OrderedDict[str, Answer] = OrderedDict()
        self._autos: dict[Recording, Auto] = {}
        self._stops: dict[Recording, list[str]] = {}
        self._ended_ns: dict[Recording, int] = {}
        self.requests: list[Request] = []
        self.recordings: dict[tuple[str, str], Recording] = {}

    # --- orders ---------------------------------------------------------------------------------------

    def record(self, order: RecordOrder) -> Request | None:
        """Take on a single request; its answer comes when all its samples are durable, or at its deadline.

        None for an order that is known: control repeats what is old. One that was answered already (its answer was
        lost, or crossed the repeat) gets the same answer again.
        """
        if order.key in self._answered:
            self._reply(self._answered[order.key])
            return None
        if any(item.order.key == order.key for item in self.requests):
            return None
        request = Request.of(order)
        self.requests.append(request)
        return request

    def start(self, order: StartOrder, resumed: CameraLedger | None = None) -> None:
        """Begin a recording on one camera; one that is known already goes on as it is."""
        key = (order.spec.recording, order.camera)
        if key in self.recordings:
            return
        recording = Recording(order.spec, order.camera, Account(resumed))
        self.recordings[key] = recording
        if order.spec.mode == "auto":
            self._autos[recording] = Auto(order.spec.auto or AutoLimits())
        get().info("recording.started", recording=key[0], camera=key[1], resumed=resumed is not None)

    def stop(self, recording: str, camera: str, order_key: str) -> bool:
        """End a recording; the answer follows when it is settled. False if it isn't known here."""
        item = self.recordings.get((recording, camera))
        if item is None:
            return False
        item.finish("stopped")
        self._stops.setdefault(item, []).append(order_key)
        if item.phase == "ended":
            self._answer_stops(item)
        return True

    # --- frames ---------------------------------------------------------------------------------------

    def needs_every_frame(self, camera: str) -> bool:
        """Whether a running recording on this camera counts its frames."""
        return any(item.camera == camera and item.phase == "running" for item in self.recordings.values())

    def active(self, camera: str) -> bool:
        """Whether anybody waits for frames of this camera."""
        return any(True for _ in self._open(camera))

    def _open(self, camera: str) -> Iterator[Taker]:
        yield from (item for item in self.requests if item.camera == camera and not item.answered)
        yield from (item for item in self.recordings.values() if item.camera == camera and item.phase == "running")

    def dropped(self, detections: Detections) -> None:
        """A frame whose detections came was passed over by label."""
        for taker in self._open(detections.ref.camera):
            if taker.account.arrived(detections.ref):
                taker.account.drop("label")

    def also_detected(self, detections: Detections) -> None:
        """Another source than the markers has spoken: recordings count it, and nothing hangs on it."""
        for taker in self._open(detections.ref.camera):
            taker.account.detected[detections.source] += 1

    def frame(self, detections: Detections, labelled: Labelled, begin: Begin, measure: Measure = dict) -> None:
        """A labelled frame: account for it, and begin a sample if somebody wants it."""
        wanting: list[Taker] = []
        for taker in self._open(detections.ref.camera):
            counted = taker.account.arrived(detections.ref)
            if not counted and isinstance(taker, Recording):
                continue
            why = taker.wants(detections.ref) or self._not_worth(taker, detections.ref, labelled, measure)
            if counted or why is None:
                taker.account.looked_at(detections.source, counted=counted)
            if why is None:
                wanting.append(taker)
            elif counted:
                taker.account.refuse(why)
        self._begin_for(wanting, detections, labelled, begin)

    def past_frame(self, request: Request, detections: Detections, labelled: Labelled, begin: Begin) -> None:
        """A request asked for just this frame, which was labelled before; nobody else sees it again."""
        if request.wants(detections.ref) is None:
            request.account.looked_at(detections.source, counted=request.account.arrived(detections.ref))
            self._begin_for([request], detections, labelled, begin)

    def _begin_for(self, wanting: list[Taker], detections: Detections, labelled: Labelled, begin: Begin) -> None:
        for background in (False, True):
            group = [taker for taker in wanting if taker.background is background]
            if group:
                self._try(detections, labelled, group, begin)

    def _try(self, detections: Detections, labelled: Labelled, takers: list[Taker], begin: Begin) -> None:
        background = takers[0].background
        try:
            if background and (labelled.objects or labelled.missing):
                raise RefusedError(explain("object_in_view"), code="object_in_view")
            if not background and not (labelled.objects or labelled.missing):
                raise RefusedError(_no_object(labelled), code="no_object")
            name = begin(detections, takers)
        except FrameLostError:
            for taker in takers:
                taker.lost()
        except RefusedError as error:
            for taker in takers:
                taker.refused(error.code, error.message)
        else:
            for taker in takers:
                taker.account.ordered(name)
                taker.taken(detections.ref)
                if isinstance(taker, Recording) and taker in self._autos:
                    self._autos[taker].take(name, labelled.objects)

    def _not_worth(self, taker: Taker, ref: FrameRef, labelled: Labelled, measure: Measure) -> str | None:
        if isinstance(taker, Request) or taker not in self._autos:
            return None
        auto = self._autos[taker]
        if labelled.missing or not labelled.objects:
            return auto.nothing(ref.frame, "incomplete" if labelled.missing else None)
        return auto.judge(ref.frame, labelled.objects, measure, clock.monotonic_ns())

    def outcome(self, outcome: Outcome) -> None:
        """A sample is durable, or was refused on its way."""
        name, reason = outcome.sample.name, outcome.reason
        for taker in outcome.sample.takers:
            if reason is None:
                taker.stored(name)
            else:
                taker.failed(name, reason, outcome.message)
                if isinstance(taker, Recording) and taker in self._autos:
                    self._autos[taker].forget(name)
        if reason is not None:
            get().info("sample.refused", sample=name, reason=reason, message=outcome.message)

    # --- time -----------------------------------------------------------------------------------------

    def tick(self, cameras: dict[str, CameraState]) -> None:
        """Deadlines of requests, ends of cameras and of recordings."""
        now = clock.monotonic_ns()
        for request in self.requests:
            if not request.answered and (request.done or now >= request.deadline_ns):
                self._answer(request)
        for recording in self.recordings.values():
            if recording.phase != "running":
                continue
            state = cameras.get(recording.camera)
            if state is not None:
                recording.account.gaps.hear(state, now, clock.wall_ns())
                _watch_end(recording, state, now)
            if recording.full:
                recording.finish(f"{recording.spec.until_count} samples are recorded")
        for item in [item for item, ended in self._ended_ns.items() if now - ended > _REMEMBER_ENDED_NS]:
            del self._ended_ns[item]
            self._autos.pop(item, None)
            self.recordings.pop((item.recording, item.camera), None)

    def finish_all(self, why: str) -> None:
        """Finish every recording and answer every request (the service is going down)."""
        for recording in self.recordings.values():
            recording.finish(why)
        for request in self.requests:
            if not request.answered:
                request.refused_late("stopping", f"tagmill is going down: {why}")
                self._answer(request)

    def _answer(self, request: Request) -> None:
        answer = request.final()
        self._answered[answer.key] = answer
        while len(self._answered) > _ANSWERS_KEPT:
            self._answered.popitem(last=False)
        self._reply(answer)

    @property
    def settled(self) -> bool:
        """Nothing is under way."""
        return not self.requests and all(item.phase == "ended" for item in self.recordings.values())

    # --- ledgers --------------------------------------------------------------------------------------

    def ledger_orders(self) -> Iterator[LedgerOrder]:
        """Accounts that the store doesn't know yet; a request's single entry goes when it is over."""
        yield from self._ledgers.due(self.recordings.values())
        for request in [item for item in self.requests if item.over]:
            self.requests.remove(request)
            yield self._ledgers.of_request(request)

    def ledger_answered(self, answer: Answer) -> None:
        """The store has (or refuses) an account; the last one ends its recording once the store has it."""
        closing = self._ledgers.answered(answer)
        if closing is None:
            return
        item = closing.recording
        if closing.error is None:
            self._ended_ns[item] = clock.monotonic_ns()
            get().info("recording.ended", recording=item.recording, camera=item.camera, why=item.why)
        self._answer_stops(item, closing.error)

    def _answer_stops(self, item: Recording, error: ErrorInfo | None = None) -> None:
        for order_key in self._stops.pop(item, []):
            self._reply(Answer(key=order_key, ledgers=(item.ledger(),), error=error))

    @property
    def judging(self) -> bool:
        """Whether a recording runs that chooses its views."""
        return any(item.phase == "running" for item in self._autos)

    def states(self) -> Iterator[RecordingState]:
        """What the bus is told of the recordings."""
        for item in self.recordings.values():
            auto = self._autos.get(item)
            yield RecordingState(
                camera=item.camera,
                ledger=item.ledger(),
                waiting_for=item.waiting_for,
                auto=None if auto is None else auto.now,
            )


def _watch_end(recording: Recording, state: CameraState, now: int) -> None:
    """A camera that played for this recording (or while it ran) is at its end: settle, then finish."""
    ours = state.played_for == recording.recording or recording.account.started
    if state.phase != "ended" or not ours:
        recording.ended_seen_ns = None
        return
    if recording.ended_seen_ns is None:
        recording.ended_seen_ns = now
    if recording.account.reached(state) or now - recording.ended_seen_ns > _END_GRACE_NS:
        recording.account.camera_ended(state, recording.recording)
        recording.finish("the camera is at its end")


def _no_object(labelled: Labelled) -> str:
    """The refusal, with the markers that were seen and why they gave no object."""
    seen = [f"{item.marker} ({item.reason})" for item in labelled.left_out if item.reason != "not_detected"]
    return explain("no_object") + (f"; markers seen: {', '.join(seen[:8])}" if seen else "")
