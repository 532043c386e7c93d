"""A driver whose library kills the process that opens it, under a real supervisord: told, retried, no core dumps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from common.bus import CommandClient, Endpoints, Poller
from common.config.models import NetworkConfig
from common.errors import TagmillError
from tests.support import third_party
from tests.support.stack import wait_for, write_rig
from tools.stack.running import running_stack

pytestmark = [pytest.mark.process, pytest.mark.timeout(300)]
DEADLINE_S = 90.0
CRASHES = 2
RIG = "dataset: {root: ./dataset, session: test}\ncameras:\n  cam0: {driver: crashing, fps: 20}\nring: {slots: 4}\n"
DRIVER = f"""\
import ctypes, time
from pathlib import Path
import numpy as np
from common.geometry import CameraModel
from services.capture.cameras.base import Description, Grabbed
from services.capture.cameras.intrinsics import label_of

class CrashingCamera:
    def __init__(self, name, config, rig):
        tries = Path(__file__).with_name("tries")
        count = len(tries.read_text()) if tries.exists() else 0
        tries.write_text("x" * (count + 1))
        if count < {CRASHES}:
            ctypes.string_at(0)
        self.about = Description(label_of(name, CameraModel.guess(64, 48), intrinsics_from="guess"), 20.0)

    def grab(self, timeout_s):
        time.sleep(0.05)
        return Grabbed(np.zeros((48, 64, 3), np.uint8))

    def describe(self):
        return self.about

    def close(self):
        pass
"""


def test_it_is_told_and_tried_again_until_it_opens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = third_party.install(tmp_path / "site", "crashing", DRIVER, "CrashingCamera")
    monkeypatch.setenv("PYTHONPATH", str(folder))
    rig = write_rig(tmp_path, RIG)
    endpoints = Endpoints.of(NetworkConfig())
    pause = Poller()
    seen: list[str] = []

    with running_stack(rig, tmp_path / "stack.log"), CommandClient(endpoints, DEADLINE_S) as client:

        def opened() -> dict[str, Any] | None:
            pause.wait(0.1)
            try:
                status: dict[str, Any] = client.request({"command": "status"}, timeout_s=3.0)
            except TagmillError:
                return None
            error = status["services"].get("capture.cam0", {}).get("last_error")
            if error and error not in seen:
                seen.append(error)
            # The service's heartbeat, which has the error, may come after the camera's state.
            streams = status["cameras"].get("cam0", {}).get("phase") == "streaming"
            return status if streams and not error else None

        wait_for(opened, DEADLINE_S, "the camera to stream after its crashes, and them to be forgotten")
        log = (endpoints.run_dir / "log" / "capture-cam0.log").read_text()
    events = [json.loads(line) for line in log.splitlines() if line.startswith("{")]
    died = [event for event in events if event["event"] == "camera.process_died"]
    assert [(event["signal"], event["opening"], event["count"]) for event in died] == [
        ("SIGSEGV", True, count) for count in range(1, CRASHES + 1)
    ]
    assert all(event["camera"] == "cam0" for event in died)
    lost = [event for event in events if event["event"] == "camera.lost"]
    assert [event["retry_in_s"] for event in lost] == [1.0, 2.0], "the back-off goes on from life to life"
    assert any("cam0: the process died by SIGSEGV while opening the camera (crashing) at " in error for error in seen)
    assert (folder / "tries").read_text() == "x" * (CRASHES + 1)
    assert not list(endpoints.run_dir.glob("*.life"))
