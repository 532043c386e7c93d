"""Writes a calibration as OpenCV's FileStorage, as ROS camera_info, or as tagmill's own file; reads all three."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from common.config import read_calibration, write_calibration
from common.errors import EXIT_OK, RefusedError
from common.labels import CameraLabel

FORMATS = ("opencv", "ros", "tagmill")
_ROS_MODELS = {5: "plumb_bob", 8: "rational_polynomial"}
_OPENCV_SUFFIXES = (".yml", ".yaml", ".xml", ".json")


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The sub-command's own arguments."""
    parser.add_argument("file", type=Path, help="a calibration in any of the three formats")
    parser.add_argument("--to", choices=FORMATS, required=True, help="the format to write")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", default=argparse.SUPPRESS, help="default: beside it, <name>-<format>"
    )
    parser.add_argument("--name", default=None, metavar="NAME", help="the camera's name (default: the file's)")
    parser.add_argument("--picture-size", metavar="WxH", help="where the file names no picture size")


def run(args: argparse.Namespace) -> int:
    """Convert one file."""
    name = args.name or args.file.stem
    label = read_calibration(args.file, name, _size(args.picture_size))
    suffix = ".yml" if args.to == "opencv" else ".yaml"
    target = args.out or args.file.with_name(f"{args.file.stem}-{args.to}{suffix}")
    if target.resolve() == args.file.resolve():
        raise RefusedError(f"{target} would be overwritten with itself; name another with --out")
    write_as(args.to, target, label)
    if args.json:
        print(json.dumps({"ok": True, "file": str(target), "format": args.to}))
    else:
        print(f"written: {target}")
        if args.to == "ros" and label.serial is not None:
            print(f"note: camera_info has no serial number; {label.serial} is not in it")
    return EXIT_OK


def write_as(form: str, target: Path, label: CameraLabel) -> None:
    """Write a calibration in a format of FORMATS, whole or not at all. Raises RefusedError, ConfigError."""
    if form == "tagmill":
        write_calibration(target, label)
        return
    if form == "opencv" and target.suffix.lower() not in _OPENCV_SUFFIXES:
        raise RefusedError(f"{target}: OpenCV tells the format by its ending, one of {', '.join(_OPENCV_SUFFIXES)}")
    temporary = target.with_name(f".{os.getpid()}.{target.name}")
    try:
        if form == "ros":
            temporary.write_text(yaml.safe_dump(_camera_info(label), sort_keys=False, default_flow_style=None), "utf-8")
        else:
            _write_storage(temporary, label)
        temporary.replace(target)
    except (OSError, cv2.error) as error:
        temporary.unlink(missing_ok=True)
        raise RefusedError(f"{target} can't be written: {error}; choose another place") from error


def _write_storage(path: Path, label: CameraLabel) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    if not storage.isOpened():
        raise OSError("its folder is not there or can't be written")
    try:
        storage.write("image_width", label.width)
        storage.write("image_height", label.height)
        storage.write("camera_matrix", np.array(label.matrix, dtype=np.float64))
        storage.write("distortion_coefficients", _coefficients(label).reshape(-1, 1))
        if label.model == "fisheye":
            storage.write("fisheye_model", 1)
        if label.serial is not None:
            storage.write("serial", label.serial)
    finally:
        storage.release()


def _camera_info(label: CameraLabel) -> dict[str, Any]:
    coefficients = _coefficients(label)
    if label.model == "fisheye":
        model = "equidistant"
    elif len(coefficients) in _ROS_MODELS:
        model = _ROS_MODELS[len(coefficients)]
    else:
        raise RefusedError(
            f"ROS knows 5 or 8 pinhole coefficients, not {len(coefficients)}; calibrate with --model 5 or 8"
        )
    matrix = [float(value) for row in label.matrix for value in row]
    projection = [float(value) for row in label.matrix for value in (*row, 0.0)]
    return {
        "image_width": label.width,
        "image_height": label.height,
        "camera_name": label.name,
        "camera_matrix": {"rows": 3, "cols": 3, "data": matrix},
        "distortion_model": model,
        "distortion_coefficients": {"rows": 1, "cols": len(coefficients), "data": coefficients.tolist()},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
        "projection_matrix": {"rows": 3, "cols": 4, "data": projection},
    }


def _coefficients(label: CameraLabel) -> np.ndarray[Any, np.dtype[np.float64]]:
    """At least five for a pinhole: others read no fewer."""
    given = np.array(label.distortion, dtype=np.float64)
    return given if label.model == "fisheye" or len(given) >= 5 else np.pad(given, (0, 5 - len(given)))


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    sides = text.lower().split("x")
    if len(sides) != 2 or not all(side.isdigit() and int(side) for side in sides):
        raise RefusedError(f"--picture-size must be like 1280x720, not {text!r}")
    return int(sides[0]), int(sides[1])
