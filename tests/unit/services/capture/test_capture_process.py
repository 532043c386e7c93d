"""The capture service as a process, on a bus of its own."""

from __future__ import annotations

import os
from pathlib import Path

import psutil
import pytest

from common.bus import Publisher
from common.errors import EXIT_BAD_CONFIG, EXIT_OK
from common.frames import FrameReader, shm_folder
from common.messages import CameraState, FrameAnnounced, FrameRef, Labels, ServiceState
from common.topics import CAMERA, FRAME, LABELS, RECORDING, SERVICE
from tests.support.stack import Listener, Stack
from tests.unit.services.capture.conftest import write_pictures
from tests.unit.services.capture.test_cues import recording

pytestmark = pytest.mark.process
RIG = "cameras:\n  cam0: {driver: files, path: photos, pace: consumer}\nring: {slots: 6}\n"


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    return path


@pytest.fixture
def ear(stack: Stack, rig: Path) -> Listener:
    """Hears everything; the bus runs."""
    proxy = stack.start_module("tests.support.bus_only", "--rig", str(rig))
    proxy.wait_for_event("service.opened")
    return stack.listen(FRAME, CAMERA, SERVICE)


def camera_state(ear: Listener, *phases: str) -> CameraState:
    def fits(message: object) -> bool:
        return isinstance(message, CameraState) and message.phase in phases

    state = ear.wait_for(lambda received: fits(received.message), why=f"the camera to be {phases}").message
    assert isinstance(state, CameraState)
    return state


def segments(stack: Stack) -> list[str]:
    return sorted(path.name for path in shm_folder().glob(f"tagmill-{stack.place.prefix}-*"))


def play(stack: Stack, ear: Listener, name: str) -> list[FrameRef]:
    """Be control and label: start a recording, answer each frame, until the camera has ended."""
    voice = Publisher(stack.endpoints, "label.0", "b")
    refs: list[FrameRef] = []

    def answer(message: object) -> bool:
        if isinstance(message, ServiceState):
            voice.publish(RECORDING, ("cam0", name), recording(name))
        if isinstance(message, FrameAnnounced) and not message.ref.preview:
            with FrameReader(message.ref.ring) as ring, ring.view(message.ref.frame) as view:
                assert view.bgr.any()
            refs.append(message.ref)
            voice.publish(LABELS, ("cam0",), Labels(ref=message.ref, objects=()))
        return isinstance(message, CameraState) and message.phase == "ended" and message.played_for == name

    try:
        ear.wait_for(lambda received: answer(received.message), 60.0, "the end of the file")
    finally:
        voice.close()
    return refs


def test_a_file_camera_from_start_to_stop(stack: Stack, ear: Listener, rig: Path, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 15)
    capture = stack.start_service("capture", rig, "--camera", "cam0")
    waiting = camera_state(ear, "waiting")
    assert (waiting.captured, waiting.paced, waiting.driver) == (0, True, "files")
    for turn, name in enumerate(("one", "two")):
        refs = play(stack, ear, name)
        assert [ref.source_name for ref in refs] == [f"img{number}.png" for number in range(1, 16)]
        assert [ref.count for ref in refs] == list(range(15 * turn + 1, 15 * turn + 16))
    state = ear.wait_for_state("capture.cam0")
    assert state.cameras == ("cam0",)
    assert state.dropped == {}
    assert state.numbers["captured"] == 30
    assert psutil.Process(capture.pid).nice() == os.nice(0), "capture is never niced"
    assert capture.stop() == EXIT_OK
    assert segments(stack) == []


def test_a_camera_that_is_not_there_is_waited_for(stack: Stack, ear: Listener, rig: Path, tmp_path: Path) -> None:
    capture = stack.start_service("capture", rig, "--camera", "cam0")
    lost = camera_state(ear, "lost")
    assert str(tmp_path / "photos") in (lost.last_error or "")
    assert (ear.wait_for_state("capture.cam0", "faulty").last_error or "").startswith(str(tmp_path / "photos"))
    write_pictures(tmp_path / "photos", 3)
    assert camera_state(ear, "waiting").last_error is None
    assert ear.wait_for_state("capture.cam0", "running")
    assert capture.stop() == EXIT_OK


def test_what_a_killed_capture_left_is_cleared_by_the_next(
    stack: Stack, ear: Listener, rig: Path, tmp_path: Path
) -> None:
    write_pictures(tmp_path / "photos", 3)
    capture = stack.start_service("capture", rig, "--camera", "cam0")
    first = camera_state(ear, "waiting")
    capture.kill()
    assert segments(stack) == [first.ring]
    again = stack.start_service("capture", rig, "--camera", "cam0")
    second = ear.wait_for(
        lambda received: (
            isinstance(received.message, CameraState)
            and received.message.phase == "waiting"
            and received.message.boot != first.boot
        )
    ).message
    assert isinstance(second, CameraState)
    assert segments(stack) == [second.ring]
    assert again.stop() == EXIT_OK
    assert segments(stack) == []


def test_a_camera_of_a_further_file(stack: Stack, ear: Listener, rig: Path, tmp_path: Path) -> None:
    further = tmp_path / "conf.d"
    write_pictures(further / "more", 3)
    (further / "cam7.yaml").write_text("cameras:\n  cam7: {driver: files, path: more}\n")
    capture = stack.start_service("capture", rig, "--camera", "cam7", "--camera-file", str(further / "cam7.yaml"))
    assert camera_state(ear, "waiting").camera.name == "cam7"
    assert capture.stop() == EXIT_OK


def test_a_file_that_begins_at_start_without_anybody_listening(stack: Stack, ear: Listener, rig: Path) -> None:
    write_pictures(rig.parent / "photos", 5)
    rig.write_text("cameras:\n  cam0: {driver: files, path: photos, fps: 100, begin: at_start}\n")
    capture = stack.start_service("capture", rig, "--camera", "cam0")
    ended = camera_state(ear, "ended")
    assert (ended.captured, ended.lost) == (5, {})
    assert capture.stop() == EXIT_OK


def test_a_bad_configuration_ends_with_78_and_a_sentence(stack: Stack, rig: Path, tmp_path: Path) -> None:
    about = tmp_path / "site" / "acme_package-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-package\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[tagmill.cameras]\nacme = acme_camera:Acme\n")
    (tmp_path / "site" / "acme_camera.py").write_text("import acme_sdk\n")
    (tmp_path / "acme.yaml").write_text("cameras:\n  cam2: {driver: acme}\n")
    cases = (
        ((), "--camera"),
        (("--camera", "cam1"), "there is no camera 'cam1'"),
        (("--camera", "cam3", "--camera-file", "nowhere.yaml"), "nowhere.yaml"),
        (
            ("--camera", "cam2", "--camera-file", str(tmp_path / "acme.yaml")),
            "No module named 'acme_sdk'; reinstall the package acme-package",
        ),
    )
    # All at once: each stays for some seconds, so that a supervisor heeds its exit code.
    started = [
        stack.start_service("capture", rig, *arguments, PYTHONPATH=str(tmp_path / "site")) for arguments, _ in cases
    ]
    for capture, (_, told) in zip(started, cases, strict=True):
        assert capture.wait(30) == EXIT_BAD_CONFIG, capture.log()
        assert told in capture.log()
        assert "Traceback" not in capture.log()


def test_idle_it_costs_next_to_nothing(stack: Stack, ear: Listener, rig: Path, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 3)
    capture = stack.start_service("capture", rig, "--camera", "cam0")
    camera_state(ear, "waiting")
    began = capture.cpu_s()
    for _ in range(4):
        ear.wait_for_state("capture.cam0")
    # Four heartbeats are about 4 s; the bound is 5 % of a core, previews and the measuring included.
    assert capture.cpu_s() - began < 0.2
