"""Files that are printed: written whole or not at all; PNG and SVG that know their true size."""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections.abc import Iterable
from html import escape
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from common.boards.raster import rasterised
from common.errors import RefusedError

Array = NDArray[np.float64]
_PNG_HEAD = 33
"""Bytes of a PNG's signature and its first chunk (IHDR), after which the pixel size may stand."""


def pdf_path(chosen: Path | None, default: str) -> Path:
    """Where the PDF goes; raises RefusedError for a name that isn't a PDF's (other files are named after it)."""
    path = chosen or Path(default)
    if path.suffix.lower() != ".pdf":
        raise RefusedError(f"--out names the PDF, so it must end in .pdf, not {path.name}", code="not_written")
    return path


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file and make its folder; raises RefusedError where that can't be done."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(data)
        temporary.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):  # what stood in the way of writing may stand in the way of this
            temporary.unlink(missing_ok=True)
        raise RefusedError(f"{path} can't be written: {error.strerror or error}", code="not_written") from error


def svg(loops: Iterable[Array], size_mm: tuple[float, float], title: str) -> bytes:
    """Black loops (n, 2), mm, on white, at true size."""
    width, height = (f"{value:.6g}" for value in size_mm)
    path = "".join("M" + "L".join(f"{x:.6g},{y:.6g}" for x, y in loop) + "Z" for loop in loops)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" viewBox="0 0 {width} {height}">'
        f'<title>{escape(title)}</title><rect width="{width}" height="{height}" fill="#fff"/>'
        f'<path fill-rule="evenodd" d="{path}"/></svg>\n'
    ).encode()


def png(loops: Iterable[Array], size_mm: tuple[float, float], px_per_mm: float) -> bytes:
    """The same as pixels; the file says how large one is, so that it is printed at true size."""
    encoded = cv2.imencode(".png", rasterised(loops, size_mm, px_per_mm))[1].tobytes()
    per_metre = round(px_per_mm * 1000)
    chunk = b"pHYs" + struct.pack(">IIB", per_metre, per_metre, 1)
    physical = struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    return encoded[:_PNG_HEAD] + physical + encoded[_PNG_HEAD:]
