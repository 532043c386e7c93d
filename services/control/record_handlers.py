"""What `record`, `start`, `stop`, `ledger` and `preview` do: orders to the label processes, ledgers from the store."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from typing import Any

from common import clock
from common.errors import RefusedError
from common.ids import new_recording
from common.labels import Ledger, RecordingSpec
from common.messages import (
    Answer,
    ErrorInfo,
    LedgerQuery,
    PreviewOrder,
    RecordOrder,
    StartOrder,
    StopOrder,
)
from services.control.commands import (
    ALL_CAMERAS,
    LedgerCommand,
    PreviewCommand,
    RecordCommand,
    StartCommand,
    StopCommand,
)
from services.control.conversations import Answers, Batch, Errand, Keys, Plain, Talk, refusal
from services.control.peers import STORE
from services.control.recordings import join
from services.control.stack import Stack

START_S = 5.0
STOP_S = 30.0
LEDGER_S = 5.0
PREVIEW_S = 3.0
PREVIEW_LEASE_S = 5.0
AFTER_TIMEOUT_S = 2.0
"""A label process answers at its own deadline; so much later control answers for it."""


class RecordHandlers:
    """One method a command; each returns the conversation that ends with the client's answer."""

    def __init__(self, stack: Stack, keys: Keys) -> None:
        self._stack = stack
        self._keys = keys

    def record(self, command: RecordCommand) -> Talk:
        """One order a camera; ok only if each camera gave all its samples."""
        cameras = self._stack.chosen(command.camera)
        recording = new_recording(clock.wall_ns())
        since = clock.monotonic_ns()
        answers = yield Batch(
            tuple(
                Errand(
                    self._stack.label_of(camera),
                    RecordOrder(
                        key=self._keys.new("record"),
                        recording=recording,
                        camera=camera,
                        count=command.count,
                        interval_s=command.interval_s,
                        timeout_s=command.timeout_s,
                        since_mono_ns=since,
                        frame=command.frame,
                        background=command.background,
                    ),
                )
                for camera in cameras
            ),
            command.timeout_s + AFTER_TIMEOUT_S,
        )
        stored: dict[str, Any] = {
            "recording": recording,
            "samples": sorted({name for answer in answers for name in answer.samples}),
            "pending": sorted({name for answer in answers for name in answer.pending}),
        }
        failed = _failed(cameras, answers)
        if not failed:
            return stored
        return refusal(*_summary(command.camera, failed), **stored, cameras=_plain_errors(failed))

    def start(self, command: StartCommand) -> Talk:
        """Begin on each camera; if one refuses, it is ended again on those that accepted."""
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
            return {"recording": spec.recording, "cameras": list(cameras), "missing": list(missing)}
        # One that did not answer may have begun all the same.
        begun = [camera for camera in cameras if camera not in failed or failed[camera].code == "timeout"]
        if begun:
            yield self._stops({camera: self._stack.label_of(camera) for camera in begun}, spec.recording, START_S)
        code, message = _summary(command.camera, failed)
        return refusal(code, f"{message}; no recording was begun", cameras=_plain_errors(failed))

    def stop(self, command: StopCommand) -> Talk:
        """End one recording or all that run; the ledgers once everything is durable."""
        known = self._stack.recordings
        wanted = known.open_ids() if command.recording is None else (command.recording,)
        running = {recording: known.open_cameras(recording) for recording in wanted}
        batches = [self._stops(cameras, recording, STOP_S) for recording, cameras in running.items()]
        errands = tuple(errand for batch in batches for errand in batch.errands)
        answers = (yield Batch(errands, STOP_S)) if errands else ()
        where = [(recording, camera) for recording, cameras in running.items() for camera in cameras]
        failed: dict[str, ErrorInfo] = {}
        ledgers: list[Ledger] = []
        for recording in wanted:
            own = [answer for (of, _), answer in zip(where, answers, strict=True) if of == recording]
            failed |= _failed([camera for of, camera in where if of == recording], own)
            told = join(ledger for answer in own for ledger in answer.ledgers)
            ledgers.append((yield from self._complete(recording, told)))
        plain = [_plain(ledger) for ledger in ledgers]
        if failed:
            return refusal(*_summary(ALL_CAMERAS, failed), ledgers=plain, cameras=_plain_errors(failed))
        return {"ledgers": plain}

    def ledger(self, command: LedgerCommand) -> Talk:
        """Live from the label processes while they all speak of it, else with the store's account."""
        told = self._stack.recordings.ledger(command.recording)
        return {"ledger": _plain((yield from self._complete(command.recording, told)))}

    def preview(self, command: PreviewCommand) -> Talk:
        """Pass the lease to the label process that serves the camera."""
        (camera,) = self._stack.chosen(command.camera)[:1]
        order = PreviewOrder(key=self._keys.new("preview"), camera=camera, inpaint=command.inpaint)
        (answer,) = yield Batch((Errand(self._stack.label_of(camera), order),), PREVIEW_S)
        if answer.error is not None:
            return refusal(answer.error.code, answer.error.message)
        return {"camera": camera, "lease_s": PREVIEW_LEASE_S}

    def _stops(self, cameras: dict[str, str], recording: str, timeout_s: float) -> Batch:
        return Batch(
            tuple(
                Errand(peer, StopOrder(key=self._keys.new("stop"), recording=recording, camera=camera))
                for camera, peer in cameras.items()
            ),
            timeout_s,
        )

    def _complete(self, recording: str, told: Ledger | None) -> Generator[Batch, Answers, Ledger]:
        """A ledger with all its cameras: what the store has, under what the label processes told.

        Raises RefusedError ``no_recording`` if neither knows it, the store's refusal if only that is known.
        """
        if told is not None and set(told.spec.cameras) <= set(told.cameras):
            return told
        order = LedgerQuery(key=self._keys.new("query"), recording=recording)
        (answer,) = yield Batch((Errand(STORE, order),), LEDGER_S)
        if told is None and answer.error is not None and answer.error.code != "no_recording":
            raise RefusedError(answer.error.message, code=answer.error.code)
        found = join([*answer.ledgers, *([told] if told is not None else [])])
        if found is None:
            raise RefusedError(self._no_such(recording), code="no_recording")
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
