"""A driver that never comes back from a call, under a real supervisord: told, its process ends, the next one streams.

The driver shortens the watchdog's limit in its own process; nothing else differs from production.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from common.bus import Endpoints
from common.config.models import NetworkConfig
from tests.support import third_party
from tests.support.stack import write_rig
from tests.support.supervised import supervised

pytestmark = [pytest.mark.process, pytest.mark.timeout(300)]
LIMIT_S = 2.5
RIG = "dataset: {root: ./dataset, session: test}\ncameras:\n  cam0: {driver: hanging, fps: 20}\nring: {slots: 4}\n"
DRIVER = f"""\
import threading, time
from pathlib import Path
import numpy as np
from common.geometry import CameraModel
from services.capture import watchdog
from services.capture.cameras.base import Description, Grabbed
from services.capture.cameras.intrinsics import label_of

watchdog.STUCK_S["grab"] = {LIMIT_S}
ORDER = Path(__file__).with_name("hang")

class HangingCamera:
    def __init__(self, name, config, rig):
        self.given = 0
        self.about = Description(label_of(name, CameraModel.guess(64, 48), intrinsics_from="guess"), 20.0)

    def grab(self, timeout_s):
        if ORDER.exists():
            ORDER.unlink()
            threading.Event().wait()
        time.sleep(0.05)
        self.given += 1
        return Grabbed(np.full((48, 64, 3), self.given % 256, np.uint8))

    def describe(self):
        return self.about

    def close(self):
        pass
"""


@pytest.mark.long
def test_its_process_ends_itself_and_the_supervisor_starts_it_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = third_party.install(tmp_path / "site", "hanging", DRIVER, "HangingCamera")
    monkeypatch.setenv("PYTHONPATH", str(folder))
    endpoints = Endpoints.of(NetworkConfig())
    with supervised(write_rig(tmp_path, RIG), "cam0") as stack:
        before = stack.pids()
        (folder / "hang").touch()
        stack.wait_back("capture-cam0", before["capture-cam0"])
        stack.wait_ready("cam0")
        after = stack.pids()
        said = (endpoints.run_dir / "log" / "capture-cam0.log").read_text()
    events = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
    assert [event["call"] for event in events if event["event"] == "camera.stalled"] == ["grab"], "said before it ends"
    assert "the driver has not come back from 'grab' for" in said
    assert "Traceback" not in said, "it is no bug of the process"
    assert after.pop("capture-cam0") != before.pop("capture-cam0")
    assert after == before, "nothing else was started anew"
    assert not list(endpoints.run_dir.glob("*.life")), "it ended in order, so the next one has no death to tell"
