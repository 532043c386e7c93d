"""The capture service with cameras that come and go, each a real process: a webcam and a network camera."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from common.errors import EXIT_OK
from common.messages import CameraState, FrameAnnounced
from common.topics import CAMERA, FRAME, SERVICE
from tests.support.stack import Listener, Stack
from tests.support.streams import rtsp_server, write_h264
from tests.support.v4l2.device import FOLDER, Webcam, library

pytestmark = pytest.mark.process


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text("cameras: {}\n")
    return path


@pytest.fixture
def ear(stack: Stack, rig: Path) -> Listener:
    """Hears everything; the bus runs."""
    proxy = stack.start_module("tests.support.bus_only", "--rig", str(rig))
    proxy.wait_for_event("service.opened")
    return stack.listen(FRAME, CAMERA, SERVICE)


def lost_and_back(
    stack: Stack, ear: Listener, rig: Path, unplug: Callable[[], object], plug: Callable[[], object]
) -> str:
    """Start the camera, lose it, have it back; returns how its loss was told."""
    capture = stack.start_service("capture", rig, "--camera", "cam0")
    ear.wait_for(lambda received: isinstance(received.message, FrameAnnounced), 30.0, "a frame")
    unplug()
    lost = camera_state(ear, "lost")
    plug()
    assert camera_state(ear, "streaming").captured >= lost.captured
    again = ear.wait_for(lambda received: isinstance(received.message, FrameAnnounced), 30.0, "a frame again").message
    assert isinstance(again, FrameAnnounced)
    assert again.ref.count > lost.captured
    assert capture.stop() == EXIT_OK
    assert "hush" not in capture.log()
    return lost.last_error or ""


def camera_state(ear: Listener, phase: str) -> CameraState:
    state = ear.wait_for(
        lambda received: isinstance(received.message, CameraState) and received.message.phase == phase,
        30.0,
        f"the camera to be {phase}",
    ).message
    assert isinstance(state, CameraState)
    return state


def test_a_webcam_is_unplugged_and_comes_back(
    stack: Stack, ear: Listener, rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    webcam = Webcam(tmp_path / "video0")
    rig.write_text("cameras:\n  cam0: {driver: webcam, path: video0, width: 640, height: 480}\n")
    monkeypatch.setenv("LD_PRELOAD", str(library()))
    monkeypatch.setenv(FOLDER, str(tmp_path))
    told = lost_and_back(stack, ear, rig, webcam.unplug, webcam.plug_in)
    assert "Test Cam: HD" in told
    assert "is gone: unplugged" in told


def test_a_network_camera_is_switched_off_and_comes_back(
    stack: Stack, ear: Listener, rig: Path, tmp_path: Path
) -> None:
    write_h264(tmp_path / "clip.mp4")
    with rtsp_server(tmp_path) as server:
        rig.write_text(
            f"cameras:\n  cam0: {{driver: stream, url: '{server.url('clip.mp4', 'admin:hush@')}', timeout_s: 3}}\n"
        )
        told = lost_and_back(stack, ear, rig, server.stop, server.start)
    assert "has ended or was cut off" in told
    assert "hush" not in told
