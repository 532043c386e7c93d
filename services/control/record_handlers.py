"""What `record`, `start`, `stop`, `ledger` and `preview` do: orders to the label processes, ledgers from the store."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from typing import Any

from common import clock
from common.commands import (
    ALL_CAMERAS,
    LedgerCommand,
    PreviewCommand,
    RecordCommand,
    StartCommand,
    StopCommand,
)
from common.errors import RefusedError
from common.ids import new_recording
from common.ledgers import CameraLedger, Ledger, RecordingSpec
from common.messages import (
    Answer,
    ErrorInfo,
    LedgerQuery,
    PreviewOrder,
    StartOrder,
    StopOrder,
)
from services.control.conversations import Answers, Batch, Errand, Keys, Plain, Talk, refusal
from services.control.peers import STORE
from services.control.recordings import join
from services.control.stack import Stack
from services.control.together import Together

NO_RECORDING = "no_recording"
START_S = 5.0
STOP_S = 30.0
LEDGER_S = 5.0
DELETED_S = 1.0
PREVIEW_S = 3.0
PREVIEW_LEASE_S = 5.0


class RecordHandlers:
    """One method a command; each returns the conversation that ends with the client's answer."""

    def __init__(self, stack: Stack, keys: Keys) -> None:
        self._stack = stack
        self._keys = keys

    def record(self, command: RecordCommand) -> Talk:
        """Ok only if each camera gave all its samples; several cameras' are taken together where that can be."""
        self._stack.refuse_while_reloading()
        cameras = self._stack.chosen(command.camera)
        several = command.count * len(cameras) > 1
        self._stack.requests += several
        try:
            outcome = yield from Together(self._stack, self._keys, command).run(cameras)
        finally:
            self._stack.requests -= several
        stored: dict[str, Any] = {
            "recording": outcome.recordings[0],
            "recordings": outcome.recordings,
            "samples": sorted({name for samples in outcome.stored.values() for name in samples}),
            "pending": sorted(outcome.pending),
            "pairs": outcome.pairs,
        }
        failed = {camera: self._explained(camera, error) for camera, error in outcome.failed.items()}
        if not failed:
            return stored
        return refusal(*_summary(command.camera, failed), **stored, cameras=_plain_errors(failed))

    def _explained(self, camera: str, error: ErrorInfo) -> ErrorInfo:
        """Label can't tell a camera without frames from one whose frames nobody looks at."""
        detect = self._stack.detect_of(camera)
        now = clock.monotonic_ns()
        if error.code != "no_frame" or detect is None or self._stack.roll_call.alive(detect, now):
            return error
        if not self._stack.present(camera, now):
            return error
        return ErrorInfo(
            code="detect_down",
            message=f"{camera} runs, but {detect}, which looks for its markers, is not there; its supervisor restarts "
            "it, so try again in a few seconds",
        )

    def start(self, command: StartCommand) -> Talk:
        """Begin on each camera; if one refuses, it is ended again on those that accepted."""
        self._stack.refuse_while_reloading()
        chosen = self._stack.chosen(command.camera)
        missing = tuple(camera for camera in chosen if not self._stack.present(camera, clock.monotonic_ns()))
        cameras = tuple(camera for camera in chosen if camera not in missing)
        if not cameras:
            raise RefusedError(
                f"nothing comes from {', '.join(missing)}; see 'tagmill status' for its capture service",
                code="no_camera",
            )
        now = clock.wall_ns()
        spec = RecordingSpec(
            recording=new_recording(now),
            mode=command.mode,
            cameras=cameras,
            every_s=command.every_s,
            until_count=command.until_count,
            background=command.background,
            started_at=clock.iso_utc(now),
            auto=command.limits(self._stack.rig.config.record.auto),
        )
        answers = yield Batch(
            tuple(
                Errand(self._stack.label_of(camera), StartOrder(key=self._keys.new("start"), spec=spec, camera=camera))
                for camera in cameras
            ),
            START_S,
        )
        failed = _failed(cameras, answers)
        if not failed:
            self._begun(spec)
            return {"recording": spec.recording, "cameras": list(cameras), "missing": list(missing)}
        # One that did not answer may have begun all the same, or begin when it goes on; `label_down` was never sent.
        begun = [camera for camera in cameras if camera not in failed or failed[camera].code == "timeout"]
        if begun:
            yield Batch(tuple(self._stop_errand(spec.recording, camera, lasting=True) for camera in begun), START_S)
        code, message = _summary(command.camera, failed)
        return refusal(code, f"{message}; no recording was begun", cameras=_plain_errors(failed))

    def stop(self, command: StopCommand) -> Talk:
        """End one recording or all that run; the ledgers once everything is durable."""
        known = self._stack.recordings
        wanted = known.open_ids() if command.recording is None else (command.recording,)
        where = [(recording, camera) for recording in wanted for camera in known.open_cameras(recording)]
        errands = tuple(self._stop_errand(recording, camera) for recording, camera in where)
        answers = (yield Batch(errands, STOP_S)) if errands else ()
        told: dict[str, list[Ledger]] = {recording: [] for recording in wanted}
        failed: dict[str, ErrorInfo] = {}
        for (recording, camera), answer in zip(where, answers, strict=True):
            told[recording].extend(answer.ledgers)
            for ledger in answer.ledgers:
                self._stack.told(ledger, camera, self._stack.label_of(camera), clock.monotonic_ns())
            # `no_recording`: it ended by itself meanwhile; its ledger is found below.
            if answer.error is not None and answer.error.code != NO_RECORDING:
                failed[camera] = answer.error
        ledgers: list[Plain] = []
        for recording, stopped in told.items():
            ended = known.parts(recording, but={camera for part in stopped for camera in part.cameras}, ended=True)
            try:
                ledgers.append(_plain((yield from self._complete(recording, join([*ended, *stopped])))))
            except RefusedError as error:
                if not failed:
                    raise
                failed.setdefault(recording, ErrorInfo(code=error.code, message=error.message))
        if failed:
            return refusal(*_summary(ALL_CAMERAS, failed), ledgers=ledgers, cameras=_plain_errors(failed))
        return {"ledgers": ledgers}

    def ledger(self, command: LedgerCommand) -> Talk:
        """Live while the label processes speak of it, else the store's account."""
        known = self._stack.recordings
        now = clock.monotonic_ns()
        live = all(self._stack.roll_call.alive(peer, now) for peer in known.open_cameras(command.recording).values())
        told = known.ledger(command.recording)
        ledger = yield from self._complete(command.recording, told, live=live)
        return {"ledger": _plain((yield from self._with_deleted(ledger)))}

    def _with_deleted(self, ledger: Ledger) -> Generator[Batch, Answers, Ledger]:
        """The store alone knows what was deleted; while it is away the ledger is told without that."""
        if not self._stack.roll_call.alive(STORE, clock.monotonic_ns()):
            return ledger
        query = LedgerQuery(key=self._keys.new("query"), recording=ledger.spec.recording)
        (answer,) = yield Batch((Errand(STORE, query),), DELETED_S)
        cameras = dict(ledger.cameras)
        for stored in answer.ledgers:
            for camera in cameras.keys() & stored.cameras.keys():
                cameras[camera] = cameras[camera].model_copy(update={"deleted": stored.cameras[camera].deleted})
        return ledger.model_copy(update={"cameras": cameras})

    def preview(self, command: PreviewCommand) -> Talk:
        """Pass the lease to the label process that serves the camera."""
        cameras = self._stack.chosen(command.camera)
        orders = tuple(
            Errand(
                self._stack.label_of(camera),
                PreviewOrder(key=self._keys.new("preview"), camera=camera, inpaint=command.inpaint),
            )
            for camera in cameras
        )
        failed = _failed(cameras, (yield Batch(orders, PREVIEW_S)))
        if failed:
            return refusal(*_summary(command.camera, failed), cameras=_plain_errors(failed))
        return {"cameras": list(cameras), "lease_s": PREVIEW_LEASE_S}

    def _begun(self, spec: RecordingSpec) -> None:
        """Know the recording at once, so that a `stop` right after finds it."""
        for camera in spec.cameras:
            ledger = Ledger(spec=spec, phase="running", cameras={camera: CameraLedger()})
            self._stack.told(ledger, camera, self._stack.label_of(camera), clock.monotonic_ns())

    def _stop_errand(self, recording: str, camera: str, *, lasting: bool = False) -> Errand:
        order = StopOrder(key=self._keys.new("stop"), recording=recording, camera=camera)
        return Errand(self._stack.label_of(camera), order, lasting)

    def _complete(self, recording: str, told: Ledger | None, *, live: bool = True) -> Generator[Batch, Answers, Ledger]:
        """A ledger with all its cameras: where the label processes haven't told all, the store's account too.

        Raises RefusedError ``no_recording`` if neither knows it, the store's refusal if only that is known.
        """
        if live and told is not None and set(told.spec.cameras) <= set(told.cameras):
            return told
        (answer,) = yield Batch(
            (Errand(STORE, LedgerQuery(key=self._keys.new("query"), recording=recording)),), LEDGER_S
        )
        if told is None and answer.error is not None and answer.error.code != NO_RECORDING:
            raise RefusedError(answer.error.message, code=answer.error.code)
        parts = [told] if told is not None else []
        found = join([*answer.ledgers, *parts] if live else [*parts, *answer.ledgers])
        if found is None:
            raise RefusedError(self._no_such(recording), code=NO_RECORDING)
        return found

    def _no_such(self, recording: str) -> str:
        running = self._stack.recordings.open_ids()
        return f"this session has no recording '{recording}'; " + (
            f"running: {', '.join(running)}" if running else "none is running"
        )


def _failed(cameras: Iterable[str], answers: Sequence[Answer]) -> dict[str, ErrorInfo]:
    return {camera: answer.error for camera, answer in zip(cameras, answers, strict=True) if answer.error is not None}


def _summary(asked: str, failed: dict[str, ErrorInfo]) -> tuple[str, str]:
    """One code and one message for all cameras that failed; each is named unless only one was asked for."""
    codes = {error.code for error in failed.values()}
    if asked != ALL_CAMERAS and len(failed) == 1:
        (only,) = failed.values()
        return only.code, only.message
    code = codes.pop() if len(codes) == 1 else "cameras_failed"
    return code, "; ".join(f"{camera}: {error.message}" for camera, error in sorted(failed.items()))


def _plain_errors(failed: dict[str, ErrorInfo]) -> Plain:
    return {camera: {"code": error.code, "message": error.message} for camera, error in sorted(failed.items())}


def _plain(ledger: Ledger) -> Plain:
    return ledger.model_dump(by_alias=True, mode="json")
