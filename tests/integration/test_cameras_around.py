"""What happens to the stack around its cameras: one drops off, one changes its size, two are recorded together."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from common.bus import Endpoints
from common.config.models import NetworkConfig
from common.dataset import SessionReader
from common.topics import LABELS
from tests.support.stack import ROOT, Listener, wait_for, write_rig
from tests.support.supervised import DEADLINE_S, NO_PAGE, SupervisedStack, check_session, run_module, supervised
from tests.support.unpluggable import install
from tools.stack.programs import SOCKET_FILE

pytestmark = [pytest.mark.process, pytest.mark.timeout(400)]

RIG = """\
dataset: {root: ./dataset, session: test}
cameras:
  cam0: {driver: unpluggable, width: 320, height: 240, fps: 6, prerendered: 4}
  cam1: {driver: synthetic, width: 320, height: 240, fps: 5, seed: 2, prerendered: 4}
"""


def account(stack: SupervisedStack, recording: str, camera: str) -> dict[str, Any]:
    return stack.ask(command="ledger", recording=recording)["ledger"]["cameras"].get(camera) or {}


def wait_recorded(stack: SupervisedStack, recording: str, camera: str, more: int) -> int:
    """Until ``more`` further samples of this camera are durable; how many there are then."""
    goal = account(stack, recording, camera).get("recorded", 0) + more

    def there() -> int | None:
        found = account(stack, recording, camera).get("recorded", 0)
        return found if found >= goal else None

    return wait_for(there, DEADLINE_S, f"{more} further samples of {camera}")


def wait_phase(stack: SupervisedStack, camera: str, phase: str) -> dict[str, Any]:
    def there() -> dict[str, Any] | None:
        found = stack.status()["cameras"][camera]
        return found if found["phase"] == phase else None

    return wait_for(there, DEADLINE_S, f"{camera} to be {phase}")


def test_a_camera_that_drops_off_during_a_recording_leaves_a_gap_and_nothing_else(tmp_path: Path) -> None:
    slow = RIG.replace("fps: 6", "fps: 3").replace("fps: 5", "fps: 2")  # a busy machine must not pass a frame over
    rig = write_rig(tmp_path, slow + NO_PAGE)
    cable = tmp_path / "unplugged"
    path = f"{install(tmp_path / 'third-party')}:{ROOT}"
    with supervised(rig, "cam0", "cam1", PYTHONPATH=path) as stack:
        recording = stack.ask(command="start", camera="all")["recording"]
        wait_recorded(stack, recording, "cam0", 3)
        pids = stack.pids()

        cable.touch()
        lost = wait_phase(stack, "cam0", "lost")
        assert "pulled the cable" in lost["last_error"]
        wait_recorded(stack, recording, "cam1", 10)
        (gap,) = account(stack, recording, "cam0")["gaps"]
        assert (gap["to"], gap["seconds"]) == (None, None), "it lasts"
        cable.unlink()

        wait_phase(stack, "cam0", "streaming")
        wait_recorded(stack, recording, "cam0", 3)
        (ledger,) = stack.ask(command="stop", recording=recording)["ledgers"]
        assert stack.pids() == pids, "nobody was restarted for that"
    away, other = ledger["cameras"]["cam0"], ledger["cameras"]["cam1"]
    (gap,) = away["gaps"]
    assert "pulled the cable" in gap["reason"]
    assert gap["from"] < gap["to"]
    assert not other["gaps"]
    for one in (away, other):
        assert one["dropped"] == {}
        assert one["captured"] == one["recorded"] + sum(one["refused"].values())
    session = tmp_path / "dataset" / "test"
    check_session(session)
    reader = SessionReader(session)
    times = [label.captured_at for label in map(reader.label, reader.samples()) if label.camera.name == "cam0"]
    assert len(times) == away["recorded"]
    before, after = [at for at in times if at <= gap["from"]], [at for at in times if at >= gap["to"]]
    assert before
    assert after
    assert len(before) + len(after) == len(times)
    assert reader.session.recordings[recording].cameras["cam0"].gaps[0].seconds == gap["seconds"]


def restart(program: str, stack: SupervisedStack) -> None:
    """`supervisorctl restart PROGRAM`, and until that camera streams again."""
    pid = stack.pids()[program]
    server = f"unix://{Endpoints.of(NetworkConfig()).run_dir / SOCKET_FILE}"
    _, done = run_module("supervisor.supervisorctl", "-s", server, "restart", program)
    assert f"{program}: started" in done.stdout, done
    stack.wait_back(program, pid)


@pytest.mark.long
def test_another_rate_or_size_takes_a_restart_of_that_capture_process_only(tmp_path: Path) -> None:
    text = RIG.replace("unpluggable", "synthetic") + NO_PAGE
    rig = write_rig(tmp_path, text)
    with supervised(rig, "cam0", "cam1") as stack:
        recording = stack.ask(command="start", camera="cam0")["recording"]
        wait_recorded(stack, recording, "cam0", 2)
        pids = stack.pids()

        write_rig(tmp_path, text.replace("fps: 6", "fps: 9"))
        restart("capture-cam0", stack)
        assert wait_phase(stack, "cam0", "streaming")["fps"] == 9
        wait_recorded(stack, recording, "cam0", 3)

        write_rig(tmp_path, text.replace("width: 320, height: 240, fps: 6", "width: 400, height: 300, fps: 6"))
        restart("capture-cam0", stack)
        assert wait_phase(stack, "cam0", "streaming")["width"] == 400
        warned = wait_for(lambda: stack.status()["services"]["store"]["warnings"], DEADLINE_S, "the warning")
        assert "camera cam0 gives pictures of 400x300 now, and this session has it with 320x240" in warned[0]["message"]
        wait_for(lambda: account(stack, recording, "cam0")["refused"].get("session_differs"), DEADLINE_S, "refusals")
        stopped = stack.ask(command="stop", recording=recording)
        assert stopped["ok"], stopped

        assert stack.ask(command="session", name="larger")["ok"]
        answer = stack.ask(command="record", camera="cam0", count=2, timeout_s=DEADLINE_S)
        assert answer["ok"], answer
        assert {name: pid for name, pid in stack.pids().items() if name != "capture-cam0"} == {
            name: pid for name, pid in pids.items() if name != "capture-cam0"
        }, "readers follow by themselves"
    sizes = {}
    for name in ("test", "larger"):
        check_session(tmp_path / "dataset" / name)
        reader = SessionReader(tmp_path / "dataset" / name)
        labels = [reader.label(sample) for sample in reader.samples()]
        sizes[name] = {(label.camera.width, label.camera.height) for label in labels}
    assert sizes == {"test": {(320, 240)}, "larger": {(400, 300)}}


TWO = """\
dataset: {root: ./dataset, session: test}
workers: {label: 2}
cameras:
  cam0: {driver: synthetic, width: 320, height: 240, fps: 4, prerendered: 4}
  cam1: {driver: synthetic, width: 320, height: 240, fps: 11, seed: 2, prerendered: 4}
"""


def test_record_on_all_cameras_takes_the_frames_nearest_in_time_and_says_how_near(tmp_path: Path) -> None:
    rig = write_rig(tmp_path, TWO + NO_PAGE)
    with supervised(rig, "cam0", "cam1") as stack:
        shares = stack.status()["shares"]["label"]
        assert len(set(shares.values())) == 2, "each camera has a label process of its own"
        listener = Listener(Endpoints.of(NetworkConfig()), LABELS)
        try:
            listener.wait_for(lambda received: received.message.ref.camera == "cam0")
            listener.wait_for(lambda received: received.message.ref.camera == "cam0")
            answer = stack.ask(command="record", camera="all", count=3, timeout_s=DEADLINE_S)
            listener.wait_for(lambda received: received.message.ref.camera == "cam0")
        finally:
            listener.close()
    assert answer["ok"], answer
    assert len(answer["samples"]) == 6
    assert len(answer["pairs"]) == 3
    heard: dict[str, dict[int, int]] = {"cam0": {}, "cam1": {}}
    for received in listener.heard:
        heard[received.message.ref.camera][received.message.ref.frame] = received.message.ref.captured_mono_ns
    reader = SessionReader(tmp_path / "dataset" / "test")
    for pair in answer["pairs"]:
        labels = {camera: reader.label(sample) for camera, sample in pair["samples"].items()}
        slow, fast = labels["cam0"], labels["cam1"]
        assert slow.pair is not None
        assert fast.pair is not None
        assert slow.pair.reference == fast.pair.reference == "cam0"
        assert slow.pair.samples == fast.pair.samples == pair["samples"]
        apart_ns = fast.captured_mono_ns - slow.captured_mono_ns
        assert abs(apart_ns) == min(abs(at - slow.captured_mono_ns) for at in heard["cam1"].values())
        assert (slow.pair.offset_ms, fast.pair.offset_ms) == (0.0, apart_ns / 1e6)
        assert slow.pair.spread_ms == fast.pair.spread_ms == abs(apart_ns) / 1e6
        assert pair["spread_ms"] == round(abs(apart_ns) / 1e6, 3)
    lines = [json.loads(line) for line in (reader.folder / "records.jsonl").read_text().splitlines()]
    assert sorted(line["spec"]["spread_ms"] for line in lines) == sorted(
        label.pair.spread_ms for label in map(reader.label, answer["samples"]) if label.pair
    )
    check_session(reader.folder)
