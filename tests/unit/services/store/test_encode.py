"""Every encoder's files, read back by decoders that it didn't bring: cv2 and libpng's own checker, Pillow, zlib."""

from __future__ import annotations

import io
import shutil
import struct
import subprocess
import zlib
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.dataset import DatasetConfig
from common.dataset import FOLDERS, SessionReader
from services.store import png
from services.store.encode import Coding
from services.store.sample import write_sample
from tests.support.samples import label_for, pixels

BOTH = pytest.mark.parametrize("without", [(), ("_FPNG",), ("_FPNG", "_ISAL")], ids=["fpng", "isal", "cv2"])
PNGFIX = shutil.which("pngfix")


@pytest.fixture(autouse=True)
def encoder(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Takes encoders away, as on a machine where they aren't installed."""
    pytest.importorskip("fpng")
    pytest.importorskip("isal")
    callspec = getattr(request.node, "callspec", None)
    for name in callspec.params.get("without", ()) if callspec else ():
        monkeypatch.setattr(png, name, None)


def picture(kind: str, height: int, width: int, depth: bool) -> np.ndarray:
    random = np.random.default_rng(height * 1000 + width)
    dtype, shape = (np.uint16, (height, width)) if depth else (np.uint8, (height, width, 3))
    most = np.iinfo(dtype).max
    if kind == "noise":
        return random.integers(0, most, shape, dtype, endpoint=True)
    if kind == "flat":
        return np.full(shape, most // 3, dtype)
    ramp = np.linspace(0, most, height * width * (1 if depth else 3)).reshape(shape)
    return ramp.astype(dtype)


def by_pillow(data: bytes) -> np.ndarray:
    read = np.asarray(PIL.Image.open(io.BytesIO(data)))
    return read[..., ::-1] if read.ndim == 3 else read.astype(np.uint16)


def chunks(data: bytes) -> dict[bytes, bytes]:
    """A PNG's chunks, their checksums verified."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    found: dict[bytes, bytes] = {}
    at = 8
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        name, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        assert struct.unpack(">I", data[at + 8 + length : at + 12 + length])[0] == zlib.crc32(name + body)
        found[name] = found.get(name, b"") + body
        at += 12 + length
    return found


def check(image: np.ndarray, data: bytes) -> None:
    read = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert read.dtype == image.dtype
    assert np.array_equal(read, image)
    assert np.array_equal(by_pillow(data), image)
    parts = chunks(data)
    assert next(iter(parts)) == b"IHDR"
    assert list(parts)[-1] == b"IEND"
    row = 1 + image[0].nbytes
    assert len(zlib.decompress(parts[b"IDAT"])) == image.shape[0] * row, "zlib's own checksum and the exact length"


@BOTH
@pytest.mark.parametrize("depth", [False, True], ids=["colour", "depth"])
@pytest.mark.parametrize("kind", ["noise", "flat", "ramp"])
@pytest.mark.parametrize("size", [(1, 1), (1, 2), (3, 5), (48, 64), (240, 320), (240, 321)])
def test_any_reader_gets_the_very_pixels(
    without: tuple[str, ...], depth: bool, kind: str, size: tuple[int, int], tmp_path: Path
) -> None:
    image = picture(kind, *size, depth)
    data = png.encode_png(image)
    check(image, data)
    if PNGFIX is not None and size[0] == 240:
        (tmp_path / "it.png").write_bytes(data)
        done = subprocess.run([PNGFIX, "--quiet", str(tmp_path / "it.png")], capture_output=True, text=True, timeout=60)
        assert (done.returncode, done.stdout) == (0, ""), "libpng has nothing to complain of"


@given(st.integers(1, 40), st.integers(1, 40), st.booleans(), st.integers(0, 2**32 - 1), st.integers(0, 16))
def test_any_pixels_come_back(height: int, width: int, depth: bool, seed: int, shift: int) -> None:
    dtype, shape = (np.uint16, (height, width)) if depth else (np.uint8, (height, width, 3))
    image = np.random.default_rng(seed).integers(0, 1 << 16, shape).astype(dtype) >> np.array(shift).astype(dtype)
    check(image, png.encode_png(image))


def test_a_part_of_a_larger_picture_is_encoded_as_it_looks() -> None:
    whole, deep = picture("noise", 40, 60, False), picture("noise", 40, 60, True)
    check(whole[5:25, 7:30], png.encode_png(whole[5:25, 7:30]))
    check(deep[5:25, 7:30], png.encode_png(deep[5:25, 7:30]))


@BOTH
def test_which_encoder_serves(without: tuple[str, ...]) -> None:
    assert (
        png.encoders()
        == {
            (): {"colour": "fpng", "noisy depth": "fpng", "smooth depth": "isal"},
            ("_FPNG",): {"colour": "isal", "noisy depth": "isal", "smooth depth": "isal"},
            ("_FPNG", "_ISAL"): {"colour": "cv2", "noisy depth": "cv2", "smooth depth": "cv2"},
        }[without]
    )


def test_noisy_depth_is_quicker_by_fpng_and_smooth_depth_by_isal() -> None:
    noisy = picture("noise", 96, 128, True) & 31
    smooth = picture("flat", 96, 128, True)
    smooth[4::8] = noisy[4::8]
    rows = zlib.decompress(chunks(png.encode_png(noisy))[b"IDAT"])
    assert rows[257] == 2, "fpng's filter: minus the pixel above"
    assert set(chunks(png.encode_png(noisy))) == {b"IHDR", b"IDAT", b"IEND"}, "nothing that only fpng reads"
    assert zlib.decompress(chunks(png.encode_png(smooth))[b"IDAT"])[257] == 1, "minus the pixel to the left"


@pytest.mark.parametrize(
    ("coding", "extension", "exact"),
    [
        (Coding(), "png", True),
        (Coding("webp"), "webp", True),
        (Coding("webp", 90), "webp", False),
        (Coding("jpeg"), "jpg", False),
        (Coding("jpeg", 40), "jpg", False),
    ],
)
def test_a_sample_in_each_format(coding: Coding, extension: str, exact: bool, tmp_path: Path) -> None:
    for folder in FOLDERS:
        (tmp_path / folder).mkdir()
    label = label_for(1)
    colour, depth = pixels(1)
    colour = cv2.GaussianBlur(colour, (0, 0), 3)
    write_sample(tmp_path, label, {"rgb": colour, "depth": depth, "original": colour}, 0, coding)
    session = SessionReader(tmp_path)
    session.verify(label.sample)
    read = session.label(label.sample)
    assert [Path(item.path).suffix for item in (read.files.rgb, read.files.original, read.files.depth)] == [
        f".{extension}",
        f".{extension}",
        ".png",
    ]
    assert np.array_equal(session.depth(read), depth)
    error = cv2.absdiff(session.colour(read), colour)
    assert error.max() == 0 if exact else error.mean() < 8


def test_quality_makes_a_difference() -> None:
    colour = cv2.GaussianBlur(picture("noise", 120, 160, False), (0, 0), 2)
    for format_ in ("jpeg", "webp"):
        small, large = (len(Coding(format_, quality).encode("rgb", colour)) for quality in (30, 95))
        assert small < large
    assert Coding("jpeg").encode("rgb", colour) == Coding("jpeg", 95).encode("rgb", colour)


@pytest.mark.parametrize("coding", [Coding("jpeg"), Coding("webp")])
def test_what_a_format_can_not_hold_is_an_error(coding: Coding) -> None:
    with pytest.raises(ValueError, match="can't be stored as"):
        coding.encode("rgb", np.zeros((4, 4), np.uint16))


def test_the_rig_file_says_how() -> None:
    assert Coding.of(DatasetConfig()) == Coding("png", None)
    assert Coding.of(DatasetConfig(format="webp", quality=80)) == Coding("webp", 80)
    with pytest.raises(ValueError, match="png is lossless and has no quality"):
        DatasetConfig(quality=80)
