"""Stands in for capture and label towards control: ``python -m tests.support.scripted_peers --rig F [--instance N]``.

Announces the cameras ``cam0`` and ``cam1`` and obeys control's orders as a label process does, with outcomes that
the order itself chooses: `record` on cam1 is refused (``no_object``), with ``background`` it is never answered;
`start` with ``every_s`` 99 is refused on cam1. Each order is written to its log as the event ``order``
before it is answered: a test that has the answer finds it there.
"""

from __future__ import annotations

import json
import sys

from common import clock
from common.bus import OrderServer, Poller, Publisher, Return
from common.ids import sample_name
from common.labels import CameraLabel
from common.ledgers import CameraLedger, Ledger
from common.messages import (
    Answer,
    CameraState,
    ErrorInfo,
    LabelOrder,
    Order,
    RecordingState,
    RecordOrder,
    StartOrder,
    StopOrder,
)
from common.service import Context, Report, main
from common.topics import CAMERA, RECORDING

CAMERAS = ("cam0", "cam1")
REFUSED_EVERY_S = 99.0
_EVERY_NS = 250_000_000


class ScriptedPeers:
    """A label process without pictures, and two cameras without one."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._orders: OrderServer | None = None
        self._publisher: Publisher | None = None
        self._recordings: dict[tuple[str, str], Ledger] = {}
        self._frame = 0
        self._due_ns = 0

    def open(self) -> None:
        endpoints = self._context.endpoints
        self._orders = OrderServer(endpoints.orders_label(self._context.instance), LabelOrder, self._context.id)
        self._publisher = Publisher(endpoints, self._context.id, self._context.boot)
        self._poller = Poller(self._orders)

    def step(self, timeout_s: float) -> None:
        assert self._orders is not None
        self._poller.wait(min(timeout_s, 0.05))
        for return_, order in self._orders.receive():
            # Not through the log, whose writer thread may come after the answer.
            print(json.dumps({"event": "order", **order.model_dump(mode="json")}), flush=True)
            answer = self._obey(order)
            if answer is not None:
                self._answer(return_, answer)
        if clock.monotonic_ns() >= self._due_ns:
            self._due_ns = clock.monotonic_ns() + _EVERY_NS
            self._tell()

    def drain(self) -> bool:
        return True

    def close(self) -> None:
        for part in (self._orders, self._publisher):
            if part is not None:
                part.close()

    def report(self) -> Report:
        return Report(cameras=CAMERAS if self._context.instance == 0 else ())

    def _answer(self, return_: Return, answer: Answer) -> None:
        assert self._orders is not None
        self._orders.answer(return_, answer)
        self._tell()

    def _obey(self, order: Order) -> Answer | None:
        match order:
            case RecordOrder(background=True):
                return None
            case RecordOrder(camera="cam1"):
                return _refusal(order, "no_object", "no configured object is in view")
            case RecordOrder():
                return Answer(key=order.key, samples=tuple(self._sample(order.camera) for _ in range(order.count)))
            case StartOrder(camera="cam1") if order.spec.every_s == REFUSED_EVERY_S:
                return _refusal(order, "wrong_state", "told to refuse")
            case StartOrder():
                self._recordings[order.spec.recording, order.camera] = Ledger(
                    spec=order.spec, phase="running", cameras={order.camera: CameraLedger()}
                )
            case StopOrder():
                return self._stop(order)
        return Answer(key=order.key)

    def _stop(self, order: StopOrder) -> Answer:
        known = self._recordings.get((order.recording, order.camera))
        if known is None:
            return _refusal(order, "no_recording", "not known")
        account = CameraLedger(captured=7, labelled=7, recorded=4, refused={"no_object": 2}, dropped={"detect": 1})
        ended = known.model_copy(
            update={"phase": "ended", "ended_at": "2026-08-30T12:00:09.000Z", "cameras": {order.camera: account}}
        )
        self._recordings[order.recording, order.camera] = ended
        return Answer(key=order.key, ledgers=(ended,))

    def _sample(self, camera: str) -> str:
        self._frame += 1
        return sample_name(clock.wall_ns(), camera, self._frame)

    def _tell(self) -> None:
        assert self._publisher is not None
        for (recording, camera), ledger in self._recordings.items():
            self._publisher.publish(RECORDING, (camera, recording), RecordingState(camera=camera, ledger=ledger))
        if self._context.instance != 0:
            return
        for name in CAMERAS:
            self._publisher.publish(CAMERA, (name,), _camera(name, self._context.boot))


def _camera(name: str, boot: str) -> CameraState:
    label = CameraLabel(
        name=name, width=320, height=240, matrix=((300, 0, 160), (0, 300, 120), (0, 0, 1)), distortion=()
    )
    return CameraState(boot=boot, phase="streaming", driver="scripted", ring="none", camera=label, fps=10)


def _refusal(order: Order, code: str, message: str) -> Answer:
    return Answer(key=order.key, error=ErrorInfo(code=code, message=message))


if __name__ == "__main__":
    sys.exit(main(ScriptedPeers, "label"))
