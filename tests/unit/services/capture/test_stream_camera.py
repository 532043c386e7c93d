"""The stream driver on loopback: a real RTSP server, a plain MJPEG server, OpenCV's own FFmpeg."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from common.config import Rig
from common.errors import CameraError, ConfigError
from services.capture.cameras.base import Grabbed
from services.capture.cameras.stream import StreamCamera
from tests.support.ports import free_port
from tests.support.streams import (
    HEIGHT,
    SHADES,
    WIDTH,
    MjpegServer,
    RtspServer,
    mjpeg_server,
    number_in,
    rtsp_server,
    write_h264,
)
from tests.unit.services.capture.conftest import write_calibration

RigOf = Callable[[str], Rig]
Open = Callable[..., StreamCamera]


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("clips")
    write_h264(folder / "clip.mp4")
    return folder


@pytest.fixture(scope="module")
def rtsp(clips: Path) -> Iterator[RtspServer]:
    with rtsp_server(clips) as made:
        yield made


@pytest.fixture
def mjpeg() -> Iterator[MjpegServer]:
    with mjpeg_server() as made:
        yield made


@pytest.fixture
def opened(rig_of: RigOf) -> Iterator[Open]:
    made = []
    threads = set(threading.enumerate())

    def make(url: str, keys: str = "timeout_s: 3") -> StreamCamera:
        rig = rig_of(f"{{driver: stream, url: '{url}', {keys}}}")
        camera = StreamCamera("cam0", rig.camera("cam0"), rig)
        made.append(camera)
        return camera

    yield make
    for camera in made:
        camera.close()
    deadline = time.monotonic() + 20
    for thread in set(threading.enumerate()) - threads:
        if thread.name.startswith("stream"):
            thread.join(deadline - time.monotonic())
            assert not thread.is_alive(), "a reading thread ends with its camera"


def frames_of(camera: StreamCamera, count: int) -> list[Grabbed]:
    return [camera.grab(10.0) for _ in range(count)]


def until_lost(camera: StreamCamera) -> tuple[str, float]:
    """What it says when it is lost, and how long the longest grab lasted."""
    longest = 0.0
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        began = time.monotonic()
        try:
            camera.grab(0.2)
        except TimeoutError:
            pass
        except CameraError as error:
            return error.message, longest
        longest = max(longest, time.monotonic() - began)
    pytest.fail("the camera was never lost")


def in_order(frames: list[Grabbed]) -> bool:
    """Each picture is the one after the one before, but for those that are told as missed."""
    numbers = [number_in(frame.bgr) for frame in frames]
    return all(
        (earlier + 1 + frame.missed) % SHADES == later
        for earlier, later, frame in zip(numbers, numbers[1:], frames[1:], strict=False)
    )


def test_rtsp_gives_every_picture_with_the_senders_time(rtsp: RtspServer, opened: Open) -> None:
    camera = opened(rtsp.url("clip.mp4"))
    about = camera.describe()
    assert (about.camera.width, about.camera.height, about.fps, about.stamps) == (WIDTH, HEIGHT, 25, "device")
    assert about.camera.intrinsics_from == "guess"
    frames = frames_of(camera, 12)
    assert in_order(frames)
    stamps = [frame.device_ns or 0 for frame in frames]
    for earlier, later, frame in zip(stamps, stamps[1:], frames[1:], strict=False):
        assert later - earlier == pytest.approx((1 + frame.missed) * 40e6, abs=2e6)


def test_mjpeg_over_http_is_stamped_by_its_arrival(mjpeg: MjpegServer, opened: Open) -> None:
    camera = opened(mjpeg.url())
    assert camera.describe().stamps == "arrival"
    frames = frames_of(camera, 8)
    assert in_order(frames)
    assert all(frame.device_ns is None for frame in frames)


def test_a_slow_consumer_gets_the_newest_and_hears_what_it_missed(mjpeg: MjpegServer, opened: Open) -> None:
    camera = opened(mjpeg.url())
    first = camera.grab(10.0)
    begun = mjpeg.sent
    wait_until(lambda: mjpeg.sent >= begun + 15)
    mjpeg.flowing.clear()
    wait_until(lambda: not mjpeg.flowing.is_set())
    late = camera.grab(10.0)
    assert late.missed >= 5
    assert (number_in(first.bgr) + 1 + late.missed) % SHADES == number_in(late.bgr)


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < deadline
        os.sched_yield()


def test_a_server_that_stalls_is_a_loss_and_its_old_picture_is_not_shown_again(clips: Path, opened: Open) -> None:
    with rtsp_server(clips) as server:
        camera = opened(server.url("clip.mp4"), "timeout_s: 1")
        frames = frames_of(camera, 3)
        server.hold()
        while comes(camera):
            pass
        message, longest = until_lost(camera)
        assert message.startswith(f"{server.url('clip.mp4')} gave no picture for")
        assert longest < 3
        assert in_order(frames)
        camera.close()
        server.start()
        assert in_order(frames_of(opened(server.url("clip.mp4")), 3)), "it goes on, and can be opened again"


def comes(camera: StreamCamera) -> bool:
    try:
        camera.grab(0.3)
    except TimeoutError:
        return False
    return True


def test_mjpeg_that_stalls_is_a_loss(mjpeg: MjpegServer, opened: Open) -> None:
    camera = opened(mjpeg.url(), "timeout_s: 1")
    camera.grab(10.0)
    mjpeg.flowing.clear()
    assert "gave no picture for" in until_lost(camera)[0]


def test_a_restarted_server_is_lost_and_taken_up_again(clips: Path, opened: Open) -> None:
    with rtsp_server(clips) as server:
        camera = opened(server.url("clip.mp4"))
        camera.grab(10.0)
        server.stop()
        assert "has ended or was cut off" in until_lost(camera)[0]
        camera.close()
        with pytest.raises(CameraError, match=f"127.0.0.1 refuses the connection at port {server.port}"):
            opened(server.url("clip.mp4"))
        server.start()
        assert in_order(frames_of(opened(server.url("clip.mp4")), 3))


def test_what_can_not_be_opened_is_told_with_its_reason(rtsp: RtspServer, mjpeg: MjpegServer, opened: Open) -> None:
    login = "admin:hush@"
    for url, reason in (
        (rtsp.url("nothing.mp4", login), r"has no such stream \(404\); check the path"),
        (mjpeg.url("nothing", login), r"has no such stream \(404\); check the path"),
        (f"rtsp://{login}127.0.0.1:{free_port()}/x", "refuses the connection at port"),
        (f"rtsp://{login}no-such-host.invalid/x", "there is no host 'no-such-host.invalid'"),
        (mjpeg.url("private"), r"wants a login \(401\); write them into the url"),
        (mjpeg.url("private", login), r"wants a login \(401\); check user name and password"),
        (mjpeg.url("text"), "can't be read as a video"),
        (rtsp.url("clip.mp4").replace("rtsp:", "http:"), "answers RTSP/1.0 400"),
        (mjpeg.url().replace("http:", "rtsp:"), "speaks another protocol"),
        (f"udp://127.0.0.1:{free_port()}", "does its sender run"),
    ):
        with pytest.raises(CameraError, match=reason) as caught:
            opened(url, "timeout_s: 0.5")
        assert "hush" not in caught.value.message
        assert "admin" not in caught.value.message


def test_a_login_is_nowhere_to_be_seen(
    mjpeg: MjpegServer, opened: Open, rig_of: RigOf, capfd: pytest.CaptureFixture[str]
) -> None:
    url = mjpeg.url(login="admin:hush@")
    camera = opened(url)
    camera.grab(10.0)
    mjpeg.flowing.clear()
    while comes(camera):
        pass
    with pytest.raises(TimeoutError) as silent:
        camera.grab(0.0)
    told = [str(silent.value), repr(camera.describe())]
    with pytest.raises(CameraError) as caught:
        opened(mjpeg.url("nothing", "admin:hush@"))
    told += [caught.value.message, *capfd.readouterr()]
    told.append(str(rig_of(f"{{driver: stream, url: '{url}'}}").as_plain()))
    assert not [text for text in told if "hush" in text or "admin" in text]


def test_a_size_that_the_rig_demands_and_the_calibration_are_held_against_the_pictures(
    mjpeg: MjpegServer, opened: Open, tmp_path: Path
) -> None:
    with pytest.raises(CameraError, match=r"gives 160x120, camera cam0 is configured for 1280x720"):
        opened(mjpeg.url(), "width: 1280, height: 720")
    write_calibration(tmp_path / "cam.yaml", 2 * WIDTH, 2 * HEIGHT)
    about = opened(mjpeg.url(), "calibration: cam.yaml").describe()
    assert about.camera.matrix[0][0] == pytest.approx(1.1 * WIDTH)
    assert "scaled by 0.500" in about.warnings[0]


def test_the_environment_is_left_as_it_was(mjpeg: MjpegServer, opened: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENCV_FFMPEG_CAPTURE_OPTIONS", "timeout;7")
    opened(mjpeg.url())
    assert os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] == "timeout;7"


def test_a_closed_one_says_so(mjpeg: MjpegServer, opened: Open) -> None:
    camera = opened(mjpeg.url())
    camera.close()
    camera.close()
    with pytest.raises(CameraError, match="camera cam0 is closed"):
        camera.grab(1.0)


@pytest.mark.parametrize(
    ("url", "reason"),
    [
        ("camera.local/stream", "it begins with one of rtsp://, rtsps://, http://"),
        ("file:///etc/passwd", "it begins with one of"),
        ("rtsp:///stream", "the host is missing"),
        ("udp://0.0.0.0", "the port is missing"),
        ("rtsp://host:99999/x", "the port must be 1 to 65535"),
        ("rtsp://admin:hu#sh@host/x", "write %40 for @"),
        ("rtsp://admin:hu/sh@host/x", "write %40 for @"),
    ],
)
def test_a_wrong_url_is_the_rig_files_mistake_and_is_not_quoted(rig_of: RigOf, url: str, reason: str) -> None:
    with pytest.raises(ConfigError) as caught:
        rig_of(f"{{driver: stream, url: '{url}'}}")
    (problem,) = caught.value.problems
    assert "cameras.cam0.url: is no address of a stream" in problem
    assert reason in problem
    assert "sh@" not in problem
