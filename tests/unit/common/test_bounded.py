"""Reading what strangers wrote: never more than was allowed, and no error but the stated ones."""

from __future__ import annotations

import os
import struct
import threading
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from common import MOST_PIXELS
from common.bounded import TooLargeError, parse_json, read_bytes
from common.file_storage import parse_file_storage
from common.pictures import decode


def png_that_claims(width: int, height: int) -> bytes:
    """A picture file of a hundred bytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"x" * 2048)
    assert read_bytes(path, 2048) == b"x" * 2048
    with pytest.raises(TooLargeError, match="larger than 1 KiB"):
        read_bytes(path, 1024)


def test_what_has_no_size_is_counted_while_it_is_read() -> None:
    with pytest.raises(TooLargeError, match="larger than 3 MiB"):
        read_bytes(Path("/dev/zero"), 3 << 20)


def test_a_pipe_is_read_to_its_end_and_not_waited_for_when_nobody_writes(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert read_bytes(pipe, 10) == b""
    reader, writer = os.pipe()
    thread = threading.Thread(target=lambda: (os.write(writer, b"rig"), os.close(writer)))
    thread.start()
    assert read_bytes(Path(f"/dev/fd/{reader}"), 10) == b"rig"
    thread.join(10)
    os.close(reader)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000, "9" * 5000, "", b"\xff\xfe", "nul"])
def test_what_is_no_json_is_a_value_error(text: str | bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        parse_json(text)


def test_a_picture_that_claims_more_pixels_than_any_camera_has_is_none() -> None:
    assert decode(png_that_claims(40_000, 40_000), cv2.IMREAD_COLOR) is None
    assert MOST_PIXELS < 40_000**2
    assert decode(b"", cv2.IMREAD_COLOR) is None
    assert decode(b"no picture", cv2.IMREAD_UNCHANGED) is None
    small = cv2.imencode(".png", np.full((4, 5, 3), 7, np.uint8))[1]
    picture = decode(small.tobytes(), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (4, 5, 3)


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
def test_what_cv2_writes_is_read_as_it_was_written(suffix: str, tmp_path: Path) -> None:
    storage = cv2.FileStorage(str(tmp_path / f"a.{suffix}"), cv2.FILE_STORAGE_WRITE)
    storage.write("number", -3)
    storage.write("real", 1.25e-7)
    storage.write("text", 'it is "quoted": yes')
    storage.write("digits", "0101")
    storage.write("matrix", np.array([[1.5, 2, 3], [4, 5, 6]]))
    storage.startWriteStruct("list", cv2.FileNode_SEQ)
    for one in (1, 2, 3):
        storage.write("", one)
    storage.endWriteStruct()
    storage.release()
    found = parse_file_storage((tmp_path / f"a.{suffix}").read_text())
    assert (found["number"], found["real"], found["digits"]) == (-3, 1.25e-7, "0101")
    assert "quoted" in found["text"]
    matrix = found["matrix"]
    assert (matrix["rows"], matrix["cols"], matrix["data"]) == (2, 3, [1.5, 2, 3, 4, 5, 6])
    assert found["list"] == [1, 2, 3]
