"""The ``realsense`` driver on software cameras that stream live through the real SDK."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import Queue
from typing import Any

import numpy as np
import pyrealsense2 as rs
import pytest

from common import clock
from common.config import Rig
from common.errors import CameraError, ConfigError
from services.capture.cameras.base import Grabbed
from services.capture.cameras.realsense import RealSenseCamera
from tests.support.realsense_recordings import Build, Lens, Plugged, SoftCamera, plain_frames, record

RigOf = Callable[[str], Rig]
SERIAL = "012345678901"
WITHIN_S = 20.0


class Bench:
    """Software cameras, and the driver opened on them."""

    def __init__(self, rig_of: RigOf) -> None:
        self._rig_of = rig_of
        self._open: list[RealSenseCamera] = []
        self.plugged = Plugged()

    def plug(self, build: Build | None = None) -> SoftCamera:
        return self.plugged.plug(build)

    def open(self, keys: str = "") -> RealSenseCamera:
        rig = self._rig_of(f"{{driver: realsense{keys and ', ' + keys}}}")
        self._open.append(RealSenseCamera("cam0", rig.camera("cam0"), rig, self.plugged.context))
        return self._open[-1]

    def close(self) -> None:
        for camera in self._open:
            camera.close()


@pytest.fixture
def bench(rig_of: RigOf) -> Iterator[Bench]:
    made = Bench(rig_of)
    yield made
    made.close()


def picture(value: int, lens: Lens | None = None) -> tuple[np.ndarray, np.ndarray]:
    size = lens or Build().colour
    return np.full((size.height, size.width, 3), value, np.uint8), np.full((size.height, size.width), value, np.uint16)


def given(soft: SoftCamera, camera: RealSenseCamera, number: int, **more: Any) -> Grabbed:
    """Send frame ``number`` and grab it."""
    soft.give(number, *picture(number % 256), **more)
    return camera.grab(WITHIN_S)


def grab_on(camera: RealSenseCamera) -> None:
    """Until something is wrong."""
    while True:
        camera.grab(WITHIN_S)


def test_frames_come_with_colour_and_aligned_depth_bit_by_bit(bench: Bench) -> None:
    soft, camera = bench.plug(), bench.open()
    for number in (1, 2, 3):
        frame = given(soft, camera, number)
        assert frame.bgr.shape == (120, 160, 3)
        assert (frame.bgr == number).all()
        assert frame.depth is not None
        assert frame.depth.dtype == np.uint16
        assert (frame.depth == number).all()
        assert frame.missed == 0


def test_it_describes_itself_from_the_factorys_numbers(bench: Bench) -> None:
    bench.plug(Build(Lens(640, 360, 461.5), Lens(320, 240, 200.0), unit_mm=0.1))
    description = bench.open().describe()
    camera = description.camera
    assert (camera.name, camera.serial, camera.intrinsics_from) == ("cam0", SERIAL, "factory")
    assert (camera.width, camera.height, description.fps, description.depth_unit_mm) == (640, 360, 30.0, 0.1)
    assert np.allclose(camera.matrix, [[461.5, 0, 319.5], [0, 461.5, 179.5], [0, 0, 1]])
    assert not description.paced
    assert not description.waits_for_start
    assert description.warnings == ()


@pytest.mark.parametrize("form", ["bgr8", "rgb8", "bgra8", "rgba8", "yuyv", "uyvy"])
def test_every_colour_format_becomes_bgr(bench: Bench, form: str) -> None:
    soft = bench.plug(Build(format=form))
    camera = bench.open()
    blue = {"bgr8": [200, 100, 50], "rgb8": [50, 100, 200], "bgra8": [200, 100, 50, 0], "rgba8": [50, 100, 200, 0]}
    # ITU-R BT.601, limited range, of the same colour: Y 98, Cb 179, Cr 99, once for each two pixels.
    pair = {"yuyv": [98, 179, 98, 99], "uyvy": [179, 98, 99, 98]}
    if form in blue:
        pixels = np.tile(np.array(blue[form], np.uint8), (120, 160, 1))
    else:
        pixels = np.tile(np.array(pair[form], np.uint8), (120, 80)).reshape(120, 160, 2)
    soft.give(1, pixels, picture(1)[1])
    found = camera.grab(WITHIN_S).bgr
    assert np.abs(found.reshape(-1, 3).astype(int) - [200, 100, 50]).max() <= (0 if form in blue else 6)


def test_the_mode_is_the_one_asked_for(bench: Bench) -> None:
    soft = bench.plug()
    for lens, fps in ((Lens(320, 240, 260.0), 30), (Lens(320, 240, 260.0), 60), (Lens(1280, 720, 900.0), 30)):
        soft.add_colour(lens, fps)
    soft.add_depth(Lens(320, 240, 200.0), 60)
    soft.add_depth(Lens(640, 480, 400.0), 30)
    for keys, size, rate in (
        ("", (1280, 720), 30.0),
        ("width: 320, height: 240, fps: 60", (320, 240), 60.0),
        ("width: 160", (160, 120), 30.0),
        ("depth_size: [640, 480]", (1280, 720), 30.0),
    ):
        camera = bench.open(keys)
        found = camera.describe()
        assert ((found.camera.width, found.camera.height), found.fps) == (size, rate)
        camera.close()
    for keys, told in (
        ("width: 1000", r"no colour mode 1000xany; it has 1280x720 at 30; 320x240 at 60, 30; 160x120 at 30"),
        ("width: 320, fps: 15", r"no colour mode 320xany at 15 frames/s"),
        ("depth_size: [64, 48]", r"no depth mode 64x48 at 30 frames/s \(colour's rate\); it has 640x480 at 30"),
    ):
        with pytest.raises(ConfigError, match=f"camera cam0: the Software RealSense .* has {told}"):
            bench.open(keys)


def test_on_usb_2_a_missing_mode_may_come_with_another_port(bench: Bench) -> None:
    bench.plug(Build(usb="2.1"))
    assert "is on USB 2" in bench.open().describe().warnings[0]
    with pytest.raises(CameraError, match="plug it into a USB 3 port"):
        bench.open("width: 1280")


def test_a_camera_without_depth_says_what_to_write(bench: Bench) -> None:
    soft = bench.plug(Build(depth=None))
    with pytest.raises(ConfigError, match="it has no depth at all; say `depth: false`"):
        bench.open()
    camera = bench.open("depth: false")
    soft.give(1, picture(7)[0])
    frame = camera.grab(WITHIN_S)
    assert frame.depth is None
    assert (frame.bgr == 7).all()
    assert camera.describe().depth_unit_mm is None


def test_a_wrong_serial_is_refused_at_once(bench: Bench) -> None:
    bench.plug()
    bench.plug(Build(serial="2"))
    began = clock.monotonic_ns()
    with pytest.raises(CameraError, match=f"no RealSense camera 999 is attached .attached: {SERIAL}, 2."):
        bench.open('serial: "999"')
    assert clock.monotonic_ns() - began < 5e9, "the SDK's own search takes 15 s"
    assert bench.open('serial: "2"').describe().camera.serial == "2"
    assert bench.open(f'serial: "{SERIAL}"').describe().camera.serial == SERIAL


def test_no_camera_is_told_at_once(bench: Bench) -> None:
    with pytest.raises(CameraError, match="no RealSense camera is attached; check its cable"):
        bench.open()


def test_partial_framesets_are_passed_over_and_gaps_counted(bench: Bench) -> None:
    soft, camera = bench.plug(), bench.open()
    assert given(soft, camera, 1).missed == 0
    for number in (2, 3):
        soft.give(number, picture(number)[0])  # their depth never comes
    frame = given(soft, camera, 4)
    assert (frame.bgr == 4).all()
    assert frame.missed == 2
    assert given(soft, camera, 9).missed == 4
    assert given(soft, camera, 2).missed == 0, "a counter that begins anew is no gap"


def test_a_stall_is_a_timeout_and_then_it_goes_on(bench: Bench) -> None:
    soft, camera = bench.plug(), bench.open()
    given(soft, camera, 1)
    with pytest.raises(TimeoutError, match=r"gave no picture within 0\.25 s"):
        camera.grab(0.25)
    assert (given(soft, camera, 2).bgr == 2).all()


def test_frames_may_be_kept_longer_than_the_sdks_memory_lasts(bench: Bench) -> None:
    soft, camera = bench.plug(), bench.open()
    kept = [given(soft, camera, number) for number in range(1, 61)]
    assert all((frame.bgr == number).all() and (frame.depth == number).all() for number, frame in enumerate(kept, 1))
    assert sum(frame.missed for frame in kept) == 0


def test_a_slow_reader_gets_the_newest_and_the_rest_is_counted(bench: Bench) -> None:
    soft, camera = bench.plug(), bench.open()
    given(soft, camera, 1)
    for number in range(2, 101):
        soft.give(number, *picture(number % 256))
    frames = []
    while not frames or int(frames[-1].bgr[0, 0, 0]) < 100:
        frames.append(camera.grab(WITHIN_S))
    assert 1 <= len(frames) < 10
    assert len(frames) + sum(frame.missed for frame in frames) == 99


def test_another_thread_runs_on_while_it_waits_and_closing_is_quick(bench: Bench) -> None:
    bench.plug()
    camera = bench.open()
    said: Queue[str] = Queue()

    def wait() -> None:
        try:
            camera.grab(1.0)
        except TimeoutError:
            said.put("timeout")

    thread = threading.Thread(target=wait)
    thread.start()
    turns = 0
    while thread.is_alive():
        turns += 1
    thread.join()
    assert said.get_nowait() == "timeout"
    assert turns > 1000, "the SDK kept the interpreter's lock"
    camera.close()
    camera.close()
    with pytest.raises(CameraError, match="is closed"):
        camera.grab(0.1)


def test_opened_again_it_streams_again(bench: Bench) -> None:
    soft = bench.plug()
    for turn in range(3):
        camera = bench.open()
        assert (given(soft, camera, 10 * turn + 1).bgr == 10 * turn + 1).all()
        camera.close()


def test_unplugged_it_says_so_and_is_found_again_by_its_serial(bench: Bench, tmp_path: Path) -> None:
    """A recording loaded as a device: the SDK tells of its coming and going as of a camera's."""
    path = record(tmp_path / "soft.db3", plain_frames(200))
    bench.plugged.load(path)
    camera = bench.open(f'serial: "{SERIAL}"')
    assert camera.grab(WITHIN_S).bgr.any()
    bench.plugged.unload(path)
    with pytest.raises(CameraError, match=f"{SERIAL}.* was unplugged; it is taken up again"):
        grab_on(camera)
    camera.close()
    with pytest.raises(CameraError, match=f"no RealSense camera {SERIAL} is attached"):
        bench.open(f'serial: "{SERIAL}"')
    bench.plugged.load(path)
    assert bench.open(f'serial: "{SERIAL}"').grab(WITHIN_S).bgr.any()


def test_another_camera_that_comes_and_goes_is_none_of_its_business(bench: Bench, tmp_path: Path) -> None:
    soft, camera = bench.plug(), bench.open()
    other = record(tmp_path / "other.db3", plain_frames(3), Build(serial="5"))
    given(soft, camera, 1)
    bench.plugged.load(other)
    bench.plugged.unload(other)
    assert (given(soft, camera, 2).bgr == 2).all()


def test_stamps_are_of_the_cameras_clock_or_of_the_hosts_where_the_sdk_maps_to_it(bench: Bench) -> None:
    mapped, soft = bench.plug(Build(serial="g", domain="global_time")), bench.plug()
    camera = bench.open(f'serial: "{SERIAL}"')
    assert [given(soft, camera, number, at_ms=1000.5 + number).device_ns for number in (1, 2)] == [
        1_001_500_000,
        1_002_500_000,
    ]
    assert camera.describe().stamps == "device"
    camera.close()
    camera = bench.open('serial: "g"')
    taken_ns = clock.monotonic_ns()
    frame = given(mapped, camera, 1, at_ms=clock.wall_ns() / 1e6)
    assert frame.device_ns is not None
    assert abs(frame.device_ns - taken_ns) < 1_000_000_000
    assert camera.describe().stamps == "monotonic"


def test_a_calibration_file_wins_over_the_factory(bench: Bench, tmp_path: Path) -> None:
    bench.plug()
    (tmp_path / "mine.yaml").write_text(
        "width: 160\nheight: 120\ncamera_matrix: [[140, 0, 80], [0, 140, 60], [0, 0, 1]]\n"
        'distortion: [0.1, 0, 0, 0, 0]\nserial: "77"\n'
    )
    description = bench.open("calibration: mine.yaml").describe()
    assert description.camera.intrinsics_from == "calibration"
    assert description.camera.matrix[0][0] == 140
    assert description.camera.serial == SERIAL
    assert f"is of the camera 77, this one is {SERIAL}" in description.warnings[0]


def test_what_the_sdk_refuses_is_one_sentence(bench: Bench) -> None:
    soft = bench.plug()
    bench.open()
    with pytest.raises(CameraError, match=r"^the Software RealSense \(serial 012345678901\) can't") as caught:
        bench.open()  # the device streams already
    assert "\n" not in caught.value.message
    assert soft.device.supports(rs.camera_info.serial_number)
