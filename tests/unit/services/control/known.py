"""States as the bus brings them, for tests of what control makes of them."""

from __future__ import annotations

from typing import Any

from common.labels import CameraLabel
from common.ledgers import CameraLedger, Ledger, RecordingPhase, RecordingSpec
from common.messages import CameraState, RecordingState, ServiceState

SECOND = 1_000_000_000


def service(name: str, boot: str = "b1", **more: Any) -> ServiceState:
    _, _, number = name.partition(".")
    instance = int(number) if number.isdigit() else 0
    more.setdefault("phase", "running")
    return ServiceState(service=name, instance=instance, boot=boot, pid=1, **more)


def camera(name: str, **more: Any) -> CameraState:
    label = CameraLabel(
        name=name, width=640, height=480, matrix=((500, 0, 320), (0, 500, 240), (0, 0, 1)), distortion=()
    )
    return CameraState(boot="b1", phase="streaming", driver="synthetic", ring="r", camera=label, fps=30, **more)


def spec(recording: str, *cameras: str, **more: Any) -> RecordingSpec:
    more.setdefault("mode", "all")
    return RecordingSpec(recording=recording, cameras=cameras, started_at="2026-08-30T12:00:00.000Z", **more)


def ledger(recording: RecordingSpec, phase: RecordingPhase = "running", **accounts: int) -> Ledger:
    """A ledger whose accounts have as many captured and recorded frames as given by camera."""
    cameras = {name: CameraLedger(captured=count, recorded=count) for name, count in accounts.items()}
    ended_at = "2026-08-30T12:01:00.000Z" if phase in ("ended", "interrupted") else None
    return Ledger(spec=recording, phase=phase, ended_at=ended_at, cameras=cameras)


def recording_state(told: Ledger, waiting_for: str | None = None) -> RecordingState:
    (name,) = told.cameras
    return RecordingState(camera=name, ledger=told, waiting_for=waiting_for)
