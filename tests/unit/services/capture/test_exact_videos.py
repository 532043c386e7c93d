"""Videos through PyAV: exact times, the same pixels and orientation as OpenCV, damage told frame by frame."""

from __future__ import annotations

import importlib.util
import wave
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from common.config.models import FilesOptions
from common.errors import CameraError
from services.capture.cameras.base import FrameSkippedError
from services.capture.cameras.exact_videos import ExactVideoSource
from services.capture.cameras.file_opening import open_source
from services.capture.cameras.file_sources import FileFrame, Source
from services.capture.cameras.videos import VideoSource
from tests.unit.services.capture.conftest import write_video

TIMES_MS = (0, 33, 100, 107, 500)


def write_variable(path: Path, codec: str = "mjpeg", times_ms: tuple[int, ...] = TIMES_MS) -> Path:
    """A video whose frames lie at these times; its left upper quarter is bright."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.width, stream.height = 64, 48
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for number, at in enumerate(times_ms):
            picture = np.full((48, 64, 3), 20 * number, np.uint8)
            picture[:24, :32] = 240
            frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
            frame.pts, frame.time_base = at, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def turn(path: Path, degrees: int) -> None:
    """Write into an MP4's track header how the phone was held."""
    a, b = {90: (0, 1), 180: (-1, 0), 270: (0, -1)}[degrees]
    numbers = [a << 16, b << 16, 0, -b << 16, a << 16, 0, 0, 0, 1 << 30]
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + 4 + 36  # version, flags; then the matrix of a version 0 header
    data[at : at + 36] = b"".join(number.to_bytes(4, "big", signed=True) for number in numbers)
    path.write_bytes(data)


def rest_of(source: Source) -> list[FileFrame]:
    frames = []
    while (frame := source.read()) is not None:
        frames.append(frame)
    return frames


def test_frames_have_their_own_times(tmp_path: Path) -> None:
    source = ExactVideoSource(write_variable(tmp_path / "clip.mkv"), None)
    assert [frame.device_ns for frame in rest_of(source)] == [at * 1_000_000 for at in TIMES_MS]
    source.rewind(3)
    assert [(frame.device_ns, frame.name) for frame in rest_of(source)] == [
        (107_000_000, "clip.mkv#3"),
        (500_000_000, "clip.mkv#4"),
    ]
    source.close()
    source.close()
    assert source.read() is None


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_a_turned_phone_gives_what_opencv_gives(tmp_path: Path, degrees: int) -> None:
    path = write_variable(tmp_path / "clip.mp4", "mpeg4")
    if degrees:
        turn(path, degrees)
    ours, theirs = ExactVideoSource(path, None).read(), VideoSource(path, None).read()
    assert ours is not None
    assert theirs is not None
    assert ours.bgr.shape == ((48, 64, 3) if degrees % 180 == 0 else (64, 48, 3))
    assert np.abs(ours.bgr.astype(int) - theirs.bgr).mean() < 2
    assert ours.bgr.flags.c_contiguous


def test_the_real_video_is_the_same_through_both(testdata: Callable[[str], Path]) -> None:
    path = testdata("wpical/two_tags.mp4")
    ours, theirs = ExactVideoSource(path, None), VideoSource(path, None)
    assert ours.fps == pytest.approx(theirs.fps)
    for _ in range(5):
        one, two = ours.read(), theirs.read()
        assert one is not None
        assert two is not None
        assert one.device_ns is not None
        assert two.device_ns is not None
        assert abs(one.device_ns - two.device_ns) < 1_000_000
        assert np.abs(one.bgr[::4, ::4].astype(int) - two.bgr[::4, ::4]).mean() < 2


def test_a_damaged_frame_is_skipped_and_the_next_one_comes(tmp_path: Path) -> None:
    path = write_video(tmp_path / "clip.avi", 6)
    data = bytearray(path.read_bytes())
    starts = [at for at in range(len(data) - 3) if data[at : at + 3] == b"\xff\xd8\xff"]
    assert len(starts) == 6
    data[starts[2] : starts[3] - 16] = bytes(starts[3] - 16 - starts[2])
    path.write_bytes(data)
    source = ExactVideoSource(path, None)
    seen = []
    for _ in range(20):
        try:
            frame = source.read()
        except FrameSkippedError as error:
            seen.append(error.reason)
            continue
        if frame is None:
            break
        seen.append(frame.name)
    assert seen == ["clip.avi#0", "clip.avi#1", "unreadable", "clip.avi#3", "clip.avi#4", "clip.avi#5"]


def test_what_is_no_video_is_a_camera_error(tmp_path: Path) -> None:
    (tmp_path / "broken.mp4").write_bytes(b"no video")
    with pytest.raises(CameraError, match=r"broken\.mp4 can't be read as a video \("):
        ExactVideoSource(tmp_path / "broken.mp4", None)
    with wave.open(str(tmp_path / "sound.wav"), "wb") as sound:
        sound.setparams((1, 2, 8000, 0, "NONE", ""))
        sound.writeframes(bytes(1600))
    with pytest.raises(CameraError, match="holds no video"):
        ExactVideoSource(tmp_path / "sound.wav", None)
    path = write_variable(tmp_path / "clip.mkv")
    source = ExactVideoSource(path, None)
    path.unlink()
    with pytest.raises(CameraError, match=r"clip\.mkv is gone"):
        source.rewind(0)


def test_without_pyav_opencv_plays_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_video(tmp_path / "clip.avi", 3)
    options = FilesOptions(path=path)
    assert isinstance(open_source("cam0", path, None, options), ExactVideoSource)
    found = importlib.util.find_spec
    monkeypatch.setattr(
        "services.capture.cameras.file_opening.find_spec", lambda name: None if name == "av" else found(name)
    )
    fallback = open_source("cam0", path, None, options)
    assert isinstance(fallback, VideoSource)
    assert len(rest_of(fallback)) == 3
