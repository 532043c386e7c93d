"""The book of a session while it is open: cameras, recordings and their accounts. Pure; no disk, no socket.

The store counts ``recorded`` itself, from samples that are durable; so it is true even if the label process died
between a sample's answer and its next account.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from common.clock import iso_utc
from common.dataset.session import RecordingProgress, SessionCamera, SessionFile, StackLife
from common.errors import RefusedError
from common.ids import sample_camera
from common.labels import CameraLabel
from common.ledgers import ALIVE, CameraLedger, Ledger, RecordingSpec, closed, with_deleted, with_recorded
from common.messages import ErrorInfo, LedgerOrder
from services.store.records import summed

UNKNOWN_RECORDING = "no_recording"
_CALIBRATION = ("width", "height", "model", "matrix", "distortion")


class Book:
    """``session.json`` in memory. ``revision`` grows with every change that must get to the disk."""

    def __init__(
        self,
        file: SessionFile,
        recorded: Mapping[str, Counter[str]],
        life: StackLife,
        deleted: Mapping[str, Counter[str]] | None = None,
    ) -> None:
        self._file = file
        self._cameras = dict(file.cameras)
        self._recordings = dict(file.recordings)
        self._progress = dict(file.progress)
        self._recorded = {recording: Counter(counts) for recording, counts in recorded.items()}
        self._deleted = {recording: Counter(counts) for recording, counts in (deleted or {}).items()}
        self._records = dict(file.records)
        self._life = life
        self._met: dict[str, int] = {}
        self.revision = 0

    @property
    def name(self) -> str:
        """The session's name."""
        return self._file.name

    @property
    def rig(self) -> dict[str, Any]:
        """The session's rig, in plain values."""
        return self._file.rig

    def snapshot(self) -> SessionFile:
        """What is to be written now."""
        return self._file.model_copy(
            update={
                "cameras": dict(self._cameras),
                "recordings": {name: self._with_counts(ledger) for name, ledger in self._recordings.items()},
                "progress": dict(self._progress),
                "records": self._records_with_deleted(),
            }
        )

    def take_rig(self, rig: dict[str, Any]) -> None:
        """Take over a rig without differences; cameras that it no longer names stay known."""
        cameras = {**self._file.rig.get("cameras", {}), **rig.get("cameras", {})}
        merged = {**rig, "cameras": cameras}
        if merged != self._file.rig:
            self._file = self._file.model_copy(update={"rig": merged})
            self.revision += 1

    # --- cameras ------------------------------------------------------------------------------------------

    def camera_differences(self, camera: CameraLabel) -> tuple[str, ...]:
        """How a camera's calibration differs from the one this session has of it; empty for a new camera."""
        history = self._cameras.get(camera.name)
        if not history:
            return ()
        known = history[-1].camera
        if (known.width, known.height) != (camera.width, camera.height):
            now, then = (f"{one.width}x{one.height}" for one in (camera, known))
            return (f"camera {camera.name} gives pictures of {now} now, and this session has it with {then}",)
        return tuple(
            f"camera {camera.name}: {field} was {getattr(known, field)}, is {getattr(camera, field)}"
            for field in _CALIBRATION
            if getattr(known, field) != getattr(camera, field)
        )

    def meet_camera(self, seen: SessionCamera) -> int:
        """Append a camera's description if it is news; returns the revision that holds it."""
        name = seen.camera.name
        history = self._cameras.get(name, ())
        if not (history and _same_description(history[-1], seen)):
            self._cameras[name] = (*history, seen)
            self.revision += 1
            self._met[name] = self.revision
        return self._met.get(name, 0)

    # --- recordings ---------------------------------------------------------------------------------------

    def sample_stored(self, recording: str | None, camera: str) -> None:
        """A sample became durable."""
        if recording is None:
            return
        self._recorded.setdefault(recording, Counter())[camera] += 1
        ledger = self._recordings.get(recording)
        # A running recording's next account brings the count to the disk, and the next start counts anew.
        if ledger is not None and ledger.phase not in ALIVE:
            self.revision += 1

    def samples_moved(self, samples: Mapping[str, str | None], *, deleted: bool) -> None:
        """Samples, each with its recording, went to the bin or came back: they stay recorded, and count as deleted."""
        for sample, recording in samples.items():
            if recording is not None:
                self._deleted.setdefault(recording, Counter())[sample_camera(sample)] += 1 if deleted else -1
        self.revision += 1

    def merge(self, order: LedgerOrder, now_wall_ns: int) -> Ledger:
        """Put one camera's account into its recording; returns the recording's ledger.

        An account older than the known one (a repeated order) changes no number. The recording has ended when
        each of its cameras has.
        """
        name, camera = order.spec.recording, order.camera
        ledger = self._recordings.get(name) or Ledger(spec=order.spec, phase="running", cameras={})
        progress = self._progress.get(name) or RecordingProgress(life=self._life)
        known = ledger.cameras.get(camera)
        if known is None or order.account.captured >= known.captured:
            ledger = ledger.model_copy(update={"cameras": {**ledger.cameras, camera: order.account}})
        if order.ended and camera not in progress.ended:
            progress = progress.model_copy(update={"ended": (*progress.ended, camera)})
        if order.why and ledger.phase in ALIVE:
            ledger = ledger.model_copy(update={"why": order.why})
        if ledger.phase in ALIVE and _all_ended(ledger.spec, ledger, progress):
            ledger = ledger.model_copy(update={"phase": "ended", "ended_at": iso_utc(now_wall_ns)})
        self._recordings[name], self._progress[name] = ledger, progress
        self.revision += 1
        return self._with_counts(ledger)

    def entry(self, order: LedgerOrder, now_wall_ns: int) -> Ledger:
        """The ledger of a camera's single request that is over; it has its place in ``records.jsonl``, not here."""
        counted = self._recorded.get(order.spec.recording, Counter())[order.camera]
        return Ledger(
            spec=order.spec,
            phase="ended",
            ended_at=iso_utc(now_wall_ns),
            why=order.why,
            cameras={order.camera: with_recorded(order.account, counted)},
        )

    def count_entry(self, entry: Ledger) -> None:
        """Such an entry was written: only its sum stays."""
        self._records = summed(self._records, entry)
        counted = self._recorded.get(entry.spec.recording, Counter())
        for camera in entry.cameras:
            counted.pop(camera, None)
        if not counted:
            self._recorded.pop(entry.spec.recording, None)
        self.revision += 1

    def knows(self, recording: str) -> bool:
        """Whether the recording's ledger is in ``session.json``."""
        return recording in self._recordings

    def query(self, recording: str | None) -> tuple[Ledger, ...]:
        """One recording's ledger, or those of all that run; raises RefusedError for an unknown one."""
        if recording is None:
            return tuple(self._with_counts(self._recordings[name]) for name in self.running())
        ledger = self._recordings.get(recording)
        if ledger is None:
            unknown = no_such(self.name, recording)
            raise RefusedError(unknown.message, code=unknown.code)
        return (self._with_counts(ledger),)

    def running(self) -> tuple[str, ...]:
        """The recordings that have not ended."""
        return tuple(name for name, ledger in self._recordings.items() if ledger.phase in ALIVE)

    def close_earlier(self, now_wall_ns: int) -> tuple[str, ...]:
        """Close what an earlier life of the stack left running; returns the recordings' names.

        Frames without a fate are counted as dropped (``interrupted``): nobody is left to tell theirs.
        """
        earlier = []
        for name in self.running():
            progress = self._progress.get(name)
            if progress is not None and progress.life == self._life:
                continue
            ledger = self._with_counts(self._recordings[name])
            why = "the stack ended before the recording did"
            self._recordings[name] = closed(ledger, iso_utc(now_wall_ns), why)
            earlier.append(name)
        if earlier:
            self.revision += 1
        return tuple(earlier)

    def with_deleted(self, ledger: Ledger) -> Ledger:
        """A ledger from ``records.jsonl``, whose lines never change, with what was deleted since."""
        deleted = self._deleted.get(ledger.spec.recording, Counter())
        return with_deleted(ledger, deleted)

    def _records_with_deleted(self) -> dict[str, CameraLedger]:
        total: Counter[str] = Counter()
        for recording, counts in self._deleted.items():
            if recording not in self._recordings:
                total.update(counts)
        return {
            camera: account.model_copy(update={"deleted": total[camera]}) for camera, account in self._records.items()
        }

    def _with_counts(self, ledger: Ledger) -> Ledger:
        counted = self._recorded.get(ledger.spec.recording)
        if counted:
            cameras = {
                camera: with_recorded(ledger.cameras.get(camera, CameraLedger()), counted.get(camera, 0))
                for camera in {**ledger.cameras, **counted}
            }
            ledger = ledger.model_copy(update={"cameras": cameras})
        return self.with_deleted(ledger)


def no_such(session: str, recording: str) -> ErrorInfo:
    """The refusal for an unknown recording."""
    return ErrorInfo(code=UNKNOWN_RECORDING, message=f"session {session} has no recording '{recording}'")


def _all_ended(spec: RecordingSpec, ledger: Ledger, progress: RecordingProgress) -> bool:
    return {*spec.cameras, *ledger.cameras} <= set(progress.ended)


def _same_description(known: SessionCamera, seen: SessionCamera) -> bool:
    # driver and fps come from another message and may be missing at first; that alone is no news
    return known.camera == seen.camera and known.depth_unit_mm == seen.depth_unit_mm
