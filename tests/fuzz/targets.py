"""What is fuzzed: each parser of something that a stranger may have written, and the errors that it may raise.

A target takes bytes. It returns or raises one of ``allowed``; anything else, a hang or a crash is a finding.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import cv2
import msgpack
import numpy as np
from pydantic import ValidationError

from common.boards.file import read_board
from common.bounded import parse_json
from common.config import load_rig, read_calibration
from common.config.extrinsics import read_extrinsics
from common.dataset.emptied import removed
from common.dataset.head import read_recording
from common.dataset.layout import sample_of_label, sample_of_picture
from common.dataset.listing import SampleIndex, item_of
from common.dataset.reader import SessionReader
from common.dataset.session import parse_versioned, read_session
from common.errors import CodecError, ConfigError, DatasetError, RefusedError, TagmillError
from common.ids import is_sample_name, sample_captured_at, sample_frame
from common.labels import Label, StoredFile
from common.markers import family
from common.messages import Answer, LabelOrder, SampleFilter, StoreOrder, decode, encode
from common.pictures import decode as decode_picture
from common.topics import TOPICS
from services.capture.cameras.azure_calibration import read_calibration as read_azure
from services.capture.cameras.base import FrameSkippedError
from services.capture.cameras.pictures import exif_orientation, read_depth, read_picture
from services.capture.cameras.ros_images import COMPRESSED, RAW, colour_of, depth_of
from services.console.guard import Guard, rules_for
from services.console.server import address_of
from services.console.viewer import SAID
from services.control.parsing import parse
from services.store.records import Records
from tests.support.samples import label_for
from tools.export.classes import naming

ROOT = Path(__file__).resolve().parents[2]

RIG_WORDS = (
    b"&a ",
    b"*a",
    b"<<: *a",
    b"!!python/object:os.system ",
    b"[[[[[[[[",
    b"{",
    b"\t",
    b"---\n",
    b": ",
    b"1e999",
)
RIG_WORDS += (b"../../etc", b"\xff\xfe", b"\xef\xbb\xbf", b"%YAML:1.0\n---\n", b"0x", b"_", b"? ", b"|2-\n", b"'", b'"')


@dataclass(frozen=True)
class Target:
    """``run`` gets a folder of its own and the bytes. ``words``: what is worth inserting."""

    name: str
    run: Callable[[Path, bytes], object]
    seeds: tuple[bytes, ...]
    allowed: tuple[type[Exception], ...]
    words: tuple[bytes, ...] = field(default=RIG_WORDS)

    def __call__(self, folder: Path, data: bytes) -> None:
        """Feed the parser once."""
        with contextlib.suppress(*self.allowed):
            self.run(folder, data)


def _file(name: str, read: Callable[[Path], object]) -> Callable[[Path, bytes], object]:
    def run(folder: Path, data: bytes) -> object:
        path = folder / name
        path.write_bytes(data)
        return read(path)

    return run


# --- files that a person writes


def _rigs() -> tuple[bytes, ...]:
    return tuple(path.read_bytes() for path in sorted((ROOT / "deploy" / "examples").glob("*.yaml")))


CAMERA = b"""\
%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 628.158, 0., 324.099, 0., 628.156, 260.908, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 0.0995485, -0.206384, 0.00754589, 0.00336531, 0. ]
"""
CAMERA_XML = b"""\
<?xml version="1.0"?>
<opencv_storage>
<image_width>640</image_width><image_height>480</image_height>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>628. 0. 324. 0. 628. 260. 0. 0. 1.</data></camera_matrix>
<distortion_coefficients><_>0.1</_><_>0</_><_>0.</_><_>1e-3</_></distortion_coefficients>
</opencv_storage>
"""
CAMERA_JSON = b"""{"width": 640, "height": 480, "serial": "x", "model": "pinhole",
"camera_matrix": [[628, 0, 324], [0, 628, 260], [0, 0, 1]], "distortion": []}"""
DICTIONARY = b'%YAML:1.0\n---\nnmarkers: 2\nmarkersize: 3\nmarker_0: "101011110"\nmarker_1: "001100010"\n'
BOARD = b"kind: charuco\ncolumns: 7\nrows: 5\nsquare_mm: 30\nmarker_mm: 22\nfamily: apriltag_36h11\n"
EXTRINSICS = b"""\
cam1: {to: cam0, rvec: [0, 0.1, 0], tvec_mm: [1, 2, 3], sd_rotation_deg: [1, 1, 1], sd_mm: [1, 1, 1],
  pairs: 3, rms_px: 0.1}
"""
CLASSES = b"box-1: carton\nbox/front: face\nlid: null\n"
FILES_WORDS = (*RIG_WORDS, b"<_>", b"</_>", b"<!DOCTYPE a [", b"<!ENTITY b 'c'>", b"&b;", b'"', b"{}", b"1" * 400)


def _classes(path: Path) -> object:
    return naming(str(path), (), all_sides=False)


# --- messages

_MANY = {"a": [1, -1, 2**63, 1.5, float("nan"), None, True, b"x", "\ud7ff" * 3], "b": {"c": {"d": []}}}
MESSAGE_WORDS = (
    b"\xdd\xff\xff\xff\xff",
    b"\xc6\xff\xff\xff\xff",
    b"\x91" * 600,
    b"\x81\xa1a" * 300,
    b"\xc7\x05\xff",
    b"\xcf" + b"\xff" * 8,
)
MESSAGE_WORDS += (b"\xd6\xff\x00\x00\x00\x00", b"\xcb\x7f\xf8" + b"\0" * 6, b"\xa3\xff\xfe\xfd", b"\xc1")


def _every_message(_: Path, data: bytes) -> None:
    for kind in (*(topic.message for topic in TOPICS), *get_args(StoreOrder), *get_args(LabelOrder)):
        with contextlib.suppress(CodecError):
            decode(kind, data)


def _packed(*plains: object) -> tuple[bytes, ...]:
    return tuple(msgpack.packb(plain, use_bin_type=True) for plain in plains)


COMMANDS = _packed(
    {"command": "record", "camera": "cam0", "count": 3, "timeout_s": 1.5},
    {"command": "start", "camera": "all", "every_s": 0, "mode": "auto", "limits": {"distance_mm": [1, 2]}},
    {"command": "samples", "session": "x", "filter": {"side": "front"}, "offset": 1, "limit": 5},
    {"command": "delete", "samples": ["20260830T120431.120Z-cam0-1", "../../etc/passwd", "9" * 5000]},
    {"command": "session", "name": "../x"},
    _MANY,
)

# --- datasets

LABEL = label_for(7).model_dump_json(by_alias=True).encode()
SESSION = b'{"schema": "tagmill.session/1", "name": "a", "created_at": "x", "rig": {}, "versions": {}, "cameras": {}}'
LEDGER = (
    b'{"spec": {"recording": "rec-a", "cameras": ["cam0"], "since": "x"}, "phase": "ended", "cameras": {"cam0": {}}}\n'
)
REMOVED = b'{"sample": "20260830T120431.120Z-cam0-48211", "recording": null}\n'
JSON_WORDS = (
    b"[" * 3000,
    b'{"a":' * 2000,
    b"1e999",
    b"9" * 5000,
    b"NaN",
    b"-Infinity",
    b'"\\ud800"',
    b"null",
    b"{}",
    b"\x00",
)


def _label(folder: Path, data: bytes) -> None:
    index = SampleIndex(folder)
    index.add(item_of(SAMPLE, data))
    decode(Answer, encode(Answer(key="k", listed=index.page(SampleFilter(), 0, 1))))
    path = folder / "label.json"
    path.write_bytes(data)
    with contextlib.suppress(DatasetError):
        read_recording(path)
    parse_versioned(Label, data.decode("utf-8", "replace"), path)


def _session(folder: Path, data: bytes) -> None:
    (folder / "session.json").write_bytes(data)
    read_session(folder)


def _lines(folder: Path, data: bytes) -> None:
    (folder / "bin").mkdir(exist_ok=True)
    (folder / "bin" / "removed.jsonl").write_bytes(data)
    assert all(is_sample_name(name) for name in removed(folder))
    (folder / "records.jsonl").write_bytes(data)
    Records(folder)


SAMPLE = "20260830T120431.120Z-cam0-48211"


def _names(folder: Path, data: bytes) -> None:
    """Whatever passes for a sample's name is a file name that stays in its folder, and has all its parts."""
    text = data.decode("utf-8", "surrogateescape")
    for sample in (text, sample_of_label(text), sample_of_picture("rgb", text)):
        if sample is not None and is_sample_name(sample):
            assert "/" not in sample
            assert "\0" not in sample
            sample_captured_at(sample)
            sample_frame(sample)
    with contextlib.suppress(DatasetError, OSError, ValueError):
        SessionReader(folder).path(StoredFile(path=text, size=0, sha256=""))


# --- pictures


def _pictures() -> Iterator[bytes]:
    y, x = np.mgrid[:64, :64]
    colour = np.dstack([x * 4, y * 4, x + y]).astype(np.uint8)
    for extension in (".png", ".jpg", ".bmp", ".webp", ".tif", ".ppm", ".jp2", ".avif"):
        yield cv2.imencode(extension, colour)[1].tobytes()
    yield cv2.imencode(".png", (colour[..., 0].astype(np.uint16) << 7))[1].tobytes()
    yield cv2.imencode(".tif", (colour[..., 0].astype(np.uint16) << 7))[1].tobytes()


PICTURE_WORDS = (
    b"\xff\xff\xff\xff",
    b"\x7f\xff\xff\xff",
    b"\0\0\0\0",
    b"\0\0\xff\xff",
    b"IHDR",
    b"IDAT",
    b"acTL",
    b"Exif\0\0II*\0",
)
PICTURE_WORDS += (
    b"\xff\xda",
    b"\xff\xc0\x00\x11\x08\xff\xff\xff\xff",
    b"VP8X",
    b"eXIf",
    b"\x80",
    b"P6\n99999 99999\n255\n",
)


def _picture(folder: Path, data: bytes) -> None:
    path = folder / "rgb_a.png"
    path.write_bytes(data)
    for read in (read_picture, read_depth):
        with contextlib.suppress(FrameSkippedError):
            read(path)
    decode_picture(data, cv2.IMREAD_COLOR)
    exif_orientation(data)


# --- recordings


def _ros_image(_: Path, data: bytes) -> None:
    """A message whose fields say what they like of the bytes that follow."""
    words = [*data.split(b"|", 4), b"", b"", b"", b""]
    encoding, height, width, step = (word.decode("latin-1") for word in words[:4])
    sizes = {"height": int(height or 0), "width": int(width or 0), "step": int(step or 0)}
    pixels = np.frombuffer(words[4], dtype=np.uint8)
    image = SimpleNamespace(encoding=encoding, format=encoding, is_bigendian=0, data=pixels, **sizes)
    for kind in (RAW, COMPRESSED):
        for read in (lambda kind: colour_of(kind, image, "a"), lambda kind: depth_of(kind, image, 1.0, "a")):
            with contextlib.suppress(FrameSkippedError):
                read(kind)


ROS_IMAGES = (
    b"yuv422|2|4|8|" + bytes(16),
    b"bgr8|2|2|6|" + bytes(12),
    b"32FC1|1|2|8|" + bytes(8),
    b"bayer_rggb8|4|4|4|" + bytes(16),
    b"rgb8; jpeg compressed bgr8|0|0|0|" + cv2.imencode(".jpg", np.zeros((2, 2, 3), np.uint8))[1].tobytes(),
)

# --- the web

REQUESTS = (
    b"127.0.0.1:8750\x1fhttp://127.0.0.1:8750\x1ftagmill_console_8750=abc; a=b\x1fBearer x\x1ftoken=a&token=b",
    b"[::1]:8750\x1fnull\x1f=;;=\x1fBearer\x1f%00%ff=%",
)


def _request(_: Path, data: bytes) -> None:
    """A request without the token never gets past the guard, whatever its headers say."""
    parts = [*data.split(b"\x1f"), b"", b"", b"", b"", b""]
    names = (b"host", b"origin", b"cookie", b"authorization")
    passed: list[object] = []

    async def app(*_: object) -> None:
        passed.append(1)

    async def send(_: object) -> None:
        pass

    async def receive() -> dict[str, object]:
        return {"type": "websocket.connect"}

    guard = Guard(app, rules_for("192.0.2.1", 8750, "s" * 43))
    for kind in ("http", "websocket"):
        scope = {"type": kind, "method": "GET", "path": parts[5].decode("latin-1"), "query_string": parts[4]}
        scope["headers"] = list(zip(names, parts[:4], strict=True))
        scope["client"] = ("192.0.2.7", 4711)
        step = guard(scope, receive, send)  # type: ignore[arg-type]
        with contextlib.suppress(StopIteration):
            step.send(None)  # type: ignore[attr-defined]
    assert not passed or parts[5] == b"/healthz"


TARGETS: tuple[Target, ...] = (
    Target("rig", _file("rig.yaml", load_rig), _rigs(), (ConfigError,)),
    Target(
        "calibration",
        _file("cal.yml", lambda path: read_calibration(path, "cam0", (640, 480))),
        (CAMERA, CAMERA_XML, CAMERA_JSON),
        (ConfigError,),
        FILES_WORDS,
    ),
    Target(
        "dictionary",
        _file("mine.yml", lambda path: family(path.name, path.parent)),
        (DICTIONARY,),
        (ConfigError,),
        FILES_WORDS,
    ),
    Target("board", _file("board.yaml", read_board), (BOARD,), (ConfigError,)),
    Target("extrinsics", _file("extrinsics.yaml", read_extrinsics), (EXTRINSICS,), (ConfigError,)),
    Target("classes", _file("classes.yaml", _classes), (CLASSES,), (RefusedError,)),
    Target("messages", _every_message, COMMANDS, (), MESSAGE_WORDS),
    Target("commands", lambda _, data: parse(data), COMMANDS, (RefusedError,), MESSAGE_WORDS),
    Target("label", _label, (LABEL,), (DatasetError,), JSON_WORDS),
    Target("session", _session, (SESSION,), (DatasetError,), JSON_WORDS),
    Target("lines", _lines, (LEDGER, REMOVED, LEDGER + REMOVED), (DatasetError,), JSON_WORDS),
    Target("json", lambda _, data: parse_json(data), (SESSION, LEDGER), (ValueError,), JSON_WORDS),
    Target(
        "azure",
        lambda _, data: read_azure(data, (1280, 720), (640, 576)),
        (b'{"CalibrationInformation": {"Cameras": []}}',),
        (TagmillError,),
        JSON_WORDS,
    ),
    Target(
        "names",
        _names,
        (SAMPLE.encode(), f"label_{SAMPLE}.json".encode(), b"../../x"),
        (),
        (b"/", b"..", b"\0", b"9" * 5000),
    ),
    Target("picture", _picture, tuple(_pictures()), (), PICTURE_WORDS),
    Target(
        "ros-image",
        _ros_image,
        ROS_IMAGES,
        (ValueError,),  # of the target's own: a size that is no number
        (b"|", b"4294967295", b"0", b"1", b"3", b"-1", b"yuyv", b"16UC1", b"mono8", b"compressedDepth"),
    ),
    Target(
        "page",
        lambda _, data: SAID.validate_json(data),
        (
            b'{"t": "hello", "v": 1}',
            b'{"t": "watch", "views": [{"id": "a", "camera": "cam0", "kind": "live"}], "visible": true}',
            b'{"t": "ack", "id": "a", "seq": 1}',
        ),
        (ValidationError,),
        JSON_WORDS,
    ),
    Target("web", _request, REQUESTS, (), (b"\x1f", b"127.0.0.1:8750", b"token=", b'"', b"\\", b";", b"/healthz")),
    Target(
        "address",
        lambda _, data: address_of(data.decode("latin-1")),
        (b"http://127.0.0.1:8750", b"http://[::1]:1"),
        (ConfigError,),
        (b"[", b"]", b"@", b":", b"%"),
    ),
)
