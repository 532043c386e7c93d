"""The label process: from markers to objects, and from wanted frames to samples.

Consumes  DETECTIONS (every), CAMERA, SHARES, SERVICE (the store's); orders from control.
Produces  LABELS for every frame, RECORDING states, PREVIEW while watched; orders to the store.
States    running; faulty while the store can't be reached although something waits for it.
"""

from __future__ import annotations

import os
import time
from functools import partial

from common import clock
from common.bus import OrderClient, OrderServer, Poller, Publisher, Return, Subscriber
from common.config import load_rig
from common.errors import ConfigError, FrameLostError, RefusedError
from common.laps import Stopwatch
from common.messages import (
    MARKERS,
    Answer,
    CameraState,
    Detections,
    ErrorInfo,
    Labels,
    Order,
    PreviewOrder,
    RecordOrder,
    ReloadOrder,
    ServiceState,
    Shares,
    StartOrder,
    StopOrder,
)
from common.service import Context, Report
from common.service.meters import Tally
from common.topics import CAMERA, DETECTIONS, LABELS, PREVIEW, SERVICE, SHARES
from services.label.cameras import Camera
from services.label.earlier_life import EarlierLife
from services.label.finish import Finisher
from services.label.labelling import Labelled, Labeller
from services.label.preview import Previews
from services.label.recorder import Recorder
from services.label.requests import Request, explain
from services.label.roster import Roster
from services.label.samples import Samples, Taker
from services.label.states import Pace, States
from services.label.streams import Streams

_ORDERS = (RecordOrder, StartOrder, StopOrder, PreviewOrder, ReloadOrder)
_BUSY_WAIT_S = 0.005
_STORE_WINDOW = 4096


class LabelService:
    """One label process; several share the cameras by camera."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._rig = context.rig
        self._log = context.log
        config = context.rig.config
        self._roster = Roster(context.instance, config.workers.label, config.ring.slots, context.log)
        self._returns: dict[str, Return] = {}
        self._recorder = Recorder(self._reply, context.boot)
        self._dropped, self._pace = Tally(), Pace()
        self._draining = False
        self._delay_s = float(os.environ.get("TAGMILL_LABEL_DELAY_MS", "0")) / 1000

    def open(self) -> None:
        """Bind the order socket, start the workers, ask the store which recordings run."""
        context, endpoints = self._context, self._context.endpoints
        self._streams = Streams(Labeller.of(self._rig), self._roster, self._log)
        self._finisher = Finisher(self._rig)
        self._samples = Samples(
            endpoints.prefix,
            context.id,
            context.boot,
            self._rig.config.ring.samples,
            keep_original=self._rig.config.dataset.keep_original,
        )
        self._publisher = Publisher(endpoints, context.id, context.boot)
        self._states = States(self._publisher)
        self._previews = Previews(
            endpoints.prefix,
            context.id,
            context.boot,
            lambda preview: self._publisher.publish(PREVIEW, (preview.of.camera,), preview),
        )
        self._orders = OrderServer(endpoints.orders_label(context.instance), _ORDERS)
        self._store = OrderClient(endpoints.orders_store, context.id, window=_STORE_WINDOW)
        self._subscriber = Subscriber(endpoints)
        for topic in (DETECTIONS, CAMERA, SHARES):
            self._subscriber.subscribe(topic)
        self._subscriber.subscribe(SERVICE, "store")
        self._poller = Poller()
        for source in (self._orders, self._store, self._subscriber, self._finisher):
            self._poller.add(source)
        self._earlier = EarlierLife(self._store, f"{context.id}/{context.boot}", self._recorder, self._roster)

    def step(self, timeout_s: float) -> None:
        """One round: orders, news, at most one frame a camera, outcomes, deadlines."""
        busy = self._samples.waiting or any(camera.waiting for camera in self._roster)
        self._poller.wait(min(timeout_s, _BUSY_WAIT_S) if busy else timeout_s)
        for return_, order in self._orders.receive():
            self._returns[order.key] = return_
            self._take_order(order)
        for received in self._subscriber.receive():
            self._hear(received.message)
        for camera in self._roster:
            self._next_frame(camera)
        self._streams.go_on(self._samples, self._finisher, all_=self._draining)
        self._collect()
        self._earlier.go_on(self._look_back, self._stop)
        self._recorder.tick(self._roster.states())
        self._roster.let_go(self._recorder.active)
        self._samples.keep_only(self._roster.names)
        self._previews.tidy()
        if len(self._store.pending) < _STORE_WINDOW // 2:
            for ledger in self._recorder.ledger_orders():
                self._store.send(ledger)
        self._states.tell(self._recorder)

    def drain(self) -> bool:
        """Take nothing new; finish what is under way."""
        self._draining = True
        self._recorder.finish_all("the stack was stopped")
        for order in self._earlier.give_up():
            self._refuse(order.key, "stopping", "tagmill is going down: the stack was stopped")
        self.step(0.05)
        idle = self._recorder.settled and not self._samples.under_way
        return idle and set(self._store.pending) <= self._earlier.keys

    def close(self) -> None:
        """Let go of everything, whatever state it is in."""
        for name in ("_finisher", "_samples", "_previews", "_orders", "_store", "_subscriber", "_publisher"):
            part = getattr(self, name, None)
            if part is not None:
                part.close()
        self._roster.close()

    def report(self) -> Report:
        """What the heartbeat says."""
        return Report(
            cameras=self._roster.names,
            rates={"labelled": self._pace.labelled.per_second()},
            dropped=self._dropped.as_dict(),
            numbers={
                "backlog": float(len(self._samples.under_way)),
                **(self._pace.numbers() | self._samples.steps.as_numbers()),
                "finisher_restarts": float(self._finisher.restarts),
            },
            faulty=bool(self._samples.under_way) and not self._store.available,
            last_error=None if self._store.available else explain("store_down"),
        )

    # --- orders ---------------------------------------------------------------------------------------

    def _take_order(self, order: Order) -> None:
        match order:
            case RecordOrder():
                self._record(order)
            case StartOrder():
                self._recorder.start(order)
                self._reply(Answer(key=order.key))
                self._states.hurry()
            case StopOrder():
                self._stop(order)
            case PreviewOrder():
                if order.inpaint:
                    self._previews.lease(order.camera)
                self._reply(Answer(key=order.key))
            case ReloadOrder():
                self._reload(order.key)

    def _stop(self, order: StopOrder) -> None:
        known = self._recorder.stop(order.recording, order.camera, order.key)
        if not known and not self._earlier.hold_stop(order):
            self._refuse(order.key, "no_recording", f"no recording {order.recording} runs on {order.camera}")

    def _record(self, order: RecordOrder) -> None:
        request = self._recorder.record(order)
        if request is not None and not self._earlier.hold_request(request):
            self._look_back(request)

    def _look_back(self, request: Request) -> None:
        """A request may be for one frame that has passed."""
        order = request.order
        camera = self._roster.get(order.camera)
        if request.done or order.frame is None or camera is None:
            return
        past = next((item for item in camera.recent if item.ref.frame == order.frame), None)
        if past is not None:
            labelled = self._streams.label_past(camera, past)
            self._recorder.past_frame(request, past, labelled, partial(self._begin, labelled))
        elif order.frame <= camera.newest and not any(item.ref.frame == order.frame for item in camera.waiting):
            request.refused_late("frame_gone", explain("frame_gone"))

    def _reload(self, key: str) -> None:
        """Take over the rig file, which control has checked."""
        try:
            rig = load_rig(self._rig.path)
            labeller = Labeller.of(rig)
        except ConfigError as error:
            self._refuse(key, error.code, error.message)
            return
        self._rig = rig
        self._streams.replace(labeller)
        self._finisher.reload(rig)
        self._samples.keep_original = rig.config.dataset.keep_original
        self._reply(Answer(key=key))
        self._log.info("rig.reloaded", objects=len(self._rig.boxes))

    def _reply(self, answer: Answer) -> None:
        return_ = self._returns.pop(answer.key, None)
        if return_ is not None:
            self._orders.answer(return_, answer)

    def _refuse(self, key: str, code: str, message: str) -> None:
        self._reply(Answer(key=key, error=ErrorInfo(code=code, message=message)))

    # --- news -----------------------------------------------------------------------------------------

    def _hear(self, message: object) -> None:
        match message:
            case Detections():
                self._roster.hear_detections(message)
                if message.source != MARKERS and self._roster.get(message.ref.camera) is not None:
                    self._recorder.also_detected(message)
            case CameraState():
                self._roster.hear_camera(message)
            case Shares():
                self._roster.hear_shares(message)
            case ServiceState():
                self._store.peer_seen(message.boot)
                self._earlier.store_seen()

    # --- frames ---------------------------------------------------------------------------------------

    def _next_frame(self, camera: Camera) -> None:
        """The oldest frame that is still good while a recording counts frames, else the newest."""
        if camera.waiting and self._hold(camera):
            return
        every = self._recorder.needs_every_frame(camera.name)
        while len(camera.waiting) > 1 and not (every and camera.alive(camera.waiting[0].ref)):
            passed = camera.waiting.popleft()
            self._dropped.add("superseded")
            self._recorder.dropped(passed)
        if camera.waiting:
            with camera.turn() as detections:
                self._frame(camera, detections)

    def _hold(self, camera: Camera) -> bool:
        """A paced camera waits for its label, so its frame is held back while no sample slot is free."""
        full = not (self._samples.room(camera.name) and self._store.available)
        return camera.hold(full and camera.state.paced and self._recorder.needs_every_frame(camera.name))

    def _frame(self, camera: Camera, detections: Detections) -> None:
        watch = Stopwatch()
        if self._delay_s:
            time.sleep(self._delay_s)  # a slow labelling, asked for by a load test
        labelled = self._streams.label(camera, detections)
        watch.lap("label")
        self._pace.mark(clock.monotonic_ns() - detections.ref.captured_mono_ns, watch.laps)
        labels = Labels(
            ref=detections.ref,
            objects=labelled.objects,
            left_out=labelled.left_out,
            missing=labelled.missing,
            took_ns=int(watch.laps["label"][0] * 1e6),
        )
        self._publisher.publish(LABELS, (camera.name,), labels)
        measure = partial(self._streams.sharpness, camera, detections.ref, labelled.objects)
        self._recorder.frame(detections, labelled, partial(self._begin, labelled), measure)
        if self._previews.watched(camera.name):
            self._previews.begin(camera, detections, self._streams.around(camera, detections), self._finisher)

    def _begin(self, labelled: Labelled, detections: Detections, takers: list[Taker]) -> str:
        if not self._store.available:
            raise RefusedError(explain("store_down"), code="store_down")
        camera = self._roster.get(detections.ref.camera)
        if camera is None:
            raise FrameLostError(f"{detections.ref.camera} is no longer served here")
        around = self._streams.around(camera, detections)
        wait = None if self._draining else self._streams.wait(camera, detections, around, labelled, takers)
        return self._samples.begin(camera, detections, around, takers, self._finisher, wait).name

    def _collect(self) -> None:
        """What the workers have finished goes to the store; what the store answers goes to who asked."""
        jobs = [item for item in self._finisher.finished() if not self._previews.finished(*item)]
        for outcome in self._samples.finished(jobs, self._rig.config.dataset.session, self._store, self._roster.others):
            self._recorder.outcome(outcome)
        for answer in self._store.receive():
            if self._earlier.answered(answer):
                continue
            if (outcome_ := self._samples.answered(answer)) is not None:
                self._recorder.outcome(outcome_)
            else:
                self._recorder.ledger_answered(answer)
