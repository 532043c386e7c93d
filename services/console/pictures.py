"""A sample's files for the gallery, by its name, which is looked up in the store's list and never joined to a path."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path, PurePosixPath
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np

from common.bounded import TooLargeError, parse_json, read_bytes
from common.dataset import SessionReader, label_path
from common.errors import DatasetError
from common.labels import StoredFile
from common.pictures import MOST_BYTES, decode
from services.console.catalog import Catalog
from services.console.depth import DepthColours
from services.console.encode import be_nice, jpeg
from services.console.line import Plain

What = Literal["rgb", "original", "depth", "label", "thumb"]

THUMB_WIDTH = 320
_THUMBS_KEPT = 1000
_THUMB_QUALITY = 80
_SIZED = 10
_MEDIA = {".png": "image/png", ".jpg": "image/jpeg", ".webp": "image/webp"}


class Found(NamedTuple):
    """A file's content."""

    data: bytes
    media_type: str


class Pictures:
    """Reads (and for thumbnails and depth, decodes) on one niced thread; keeps the newest thumbnails."""

    def __init__(self) -> None:
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="console-gallery", initializer=be_nice)
        self._thumbs: OrderedDict[str, bytes] = OrderedDict()
        self._sized: tuple[int, float | None] = (-1, None)

    async def read(self, session: Path, item: Plain, what: What, *, binned: bool) -> Found:
        """A file of the sample ``item`` (as listed) below the folder ``session``; raises DatasetError."""
        key = f"{session}/{item['name']}"
        if what == "thumb" and key in self._thumbs:
            self._thumbs.move_to_end(key)
            return Found(self._thumbs[key], "image/jpeg")
        loop = asyncio.get_running_loop()
        found = await loop.run_in_executor(self._worker, _read, session, item, what, binned)
        if what == "thumb":
            self._thumbs[key] = found.data
            while len(self._thumbs) > _THUMBS_KEPT:
                self._thumbs.popitem(last=False)
        return found

    async def mean_bytes(self, session: Path, catalog: Catalog) -> float | None:
        """How large the newest samples are on the disk, on average; None while there is none."""
        if catalog.version != self._sized[0]:
            newest = sorted(catalog.stored)[-_SIZED:]
            items = [catalog.stored[name] for name in newest]
            loop = asyncio.get_running_loop()
            self._sized = (catalog.version, await loop.run_in_executor(self._worker, _mean_bytes, session, items))
        return self._sized[1]

    def close(self) -> None:
        """End the thread; idempotent."""
        self._worker.shutdown(wait=True, cancel_futures=True)


def _read(session: Path, item: Plain, what: What, binned: bool) -> Found:
    if what == "label":
        return Found(_label_text(session, item["name"], binned), "application/json")
    kind = "rgb" if what == "thumb" else what
    path = item["files"].get(kind)
    if path is None:
        raise DatasetError(f"{item['name']} has no {kind} picture", code="missing_file")
    data = _bytes(session, path)
    if what in {"rgb", "original"}:
        return Found(data, _MEDIA.get(PurePosixPath(path).suffix, "application/octet-stream"))
    picture = decode(data, cv2.IMREAD_COLOR if what == "thumb" else cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise DatasetError(f"{path} is no picture that can be read; it is damaged", code="damaged")
    if what == "depth":
        unit_mm = _depth_unit(_label_text(session, item["name"], binned))
        return Found(jpeg(DepthColours().paint(np.asarray(picture, np.uint16), unit_mm)), "image/jpeg")
    height, width = picture.shape[:2]
    small = cv2.resize(
        picture, (THUMB_WIDTH, max(1, round(height * THUMB_WIDTH / width))), interpolation=cv2.INTER_AREA
    )
    return Found(jpeg(np.asarray(small, np.uint8), _THUMB_QUALITY), "image/jpeg")


def _label_text(session: Path, name: str, binned: bool) -> bytes:
    path = label_path(name)
    return _bytes(session, str(PurePosixPath("bin", path) if binned else path))


def _depth_unit(text: bytes) -> float:
    try:
        plain: Any = parse_json(text)
        return float(plain["depth"]["unit_mm"])
    except (ValueError, KeyError, TypeError) as error:
        raise DatasetError("the label doesn't say what the depth picture counts in") from error


def _bytes(session: Path, path: str) -> bytes:
    """A file's content; the reader refuses a path that leads out of the session."""
    where = SessionReader(session).path(StoredFile(path=path, size=0, sha256=""))
    try:
        return read_bytes(where, MOST_BYTES)
    except FileNotFoundError:
        raise DatasetError(f"{path} is missing", code="missing_file") from None
    except (OSError, TooLargeError) as error:
        raise DatasetError(f"{path} can't be read: {getattr(error, 'strerror', None) or error}") from error


def _mean_bytes(session: Path, items: list[Plain]) -> float | None:
    sizes = []
    for item in items:
        try:
            sizes.append(sum((session / path).stat().st_size for path in item["files"].values()))
        except OSError:  # deleted meanwhile
            continue
    return sum(sizes) / len(sizes) if sizes else None
