"""What `status` answers, put together from what was last heard. Pure."""

from __future__ import annotations

from typing import Any

from common import VERSION
from common.messages import SCHEMA_VERSION, ServiceState
from common.service.liveness import Seen as SeenService
from services.control.peers import STORE
from services.control.recordings import Seen as SeenRecording
from services.control.stack import SeenCamera, Stack

Plain = dict[str, Any]


def status_answer(stack: Stack, now_ns: int) -> Plain:
    """The whole stack; ages are in seconds since it was last heard."""
    heard = stack.roll_call.heard
    store = heard[STORE].state if STORE in heard else None
    return {
        "settled": stack.settled,
        "services": {name: _service(stack, name, seen, now_ns) for name, seen in heard.items()},
        "missing": list(stack.roll_call.missing(stack.expected, now_ns)),
        "cameras": {name: _camera(stack, name, seen, now_ns) for name, seen in sorted(stack.cameras.items())},
        "recordings": {
            recording: _recording(stack, recording, parts, now_ns)
            for recording, parts in stack.recordings.known.items()
        },
        "shares": stack.shares.model_dump(include={"detect", "label"}),
        "backlog": sum(int(heard[name].state.numbers.get("backlog", 0)) for name in stack.labels if name in heard),
        "disk": {"free_bytes": _number(store, "free_bytes")},
        "session": stack.session,
        "dataset": str(stack.rig.dataset_root),
        "rig": str(stack.rig.path),
        "rig_fingerprint": stack.rig.fingerprint,
        "prefix": stack.endpoints.prefix,
        "versions": {"tagmill": VERSION, "messages": SCHEMA_VERSION},
    }


def _service(stack: Stack, name: str, seen: SeenService, now_ns: int) -> Plain:
    state = seen.state
    return {
        "alive": stack.roll_call.alive(name, now_ns),
        "age_s": _age(seen.at_ns, now_ns),
        "restarts": seen.restarts,
    } | state.model_dump(
        include={
            *("phase", "pid", "instance", "camera", "cameras", "rates", "dropped", "numbers"),
            *("texts", "last_error", "warnings"),
        },
        mode="json",
    )


def _camera(stack: Stack, name: str, seen: SeenCamera, now_ns: int) -> Plain:
    state = seen.state
    return {
        "present": stack.present(name, now_ns),
        "age_s": _age(seen.seen_ns, now_ns),
        "phase": state.phase,
        "driver": state.driver,
        "width": state.camera.width,
        "height": state.camera.height,
        "fps": state.fps,
        "depth": state.depth_unit_mm is not None,
        "calibration": state.camera.intrinsics_from,
        "serial": state.camera.serial,
        "captured": state.captured,
        "frame_age_s": _age(state.newest_mono_ns, now_ns) if state.newest_mono_ns else None,
        "lost": state.lost,
        "last_error": state.last_error,
    }


def _recording(stack: Stack, recording: str, parts: dict[str, SeenRecording], now_ns: int) -> Plain:
    ledger = stack.recordings.ledger(recording)
    assert ledger is not None, "parts is never empty"
    return {
        "phase": ledger.phase,
        "mode": ledger.spec.mode,
        "every_s": ledger.spec.every_s,
        "until_count": ledger.spec.until_count,
        "started_at": ledger.spec.started_at,
        "ended_at": ledger.ended_at,
        "why": ledger.why,
        "age_s": min(_age(seen.seen_ns, now_ns) for seen in parts.values()),
        "cameras": {
            camera: account.model_dump(include={"captured", "labelled", "recorded", "refused", "dropped", "pending"})
            for camera, account in sorted(ledger.cameras.items())
        },
        "waiting_for": {
            camera: seen.state.waiting_for for camera, seen in sorted(parts.items()) if seen.state.waiting_for
        },
    }


def _number(service: ServiceState | None, name: str) -> int | None:
    """A number of a service's heartbeat; None while it has not told it."""
    number = service.numbers.get(name) if service is not None else None
    return None if number is None else int(number)


def _age(seen_ns: int, now_ns: int) -> float:
    return round((now_ns - seen_ns) / 1e9, 3)
