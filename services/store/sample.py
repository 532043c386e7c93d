"""One sample to the disk: pictures first, the label last, each of them whole or absent."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from common.dataset.durable import sync_folder, temporary_path, write_bytes
from common.dataset.layout import PICTURES, PictureKind, label_path, picture_path
from common.errors import RefusedError
from common.frames import Pictures
from common.labels import Label, SampleFiles, StoredFile
from common.laps import Stopwatch
from services.store.disk import require_room
from services.store.encode import LOSSLESS, Coding

BAD_SAMPLE = "bad_sample"

Picture = NDArray[np.uint8] | NDArray[np.uint16]


def is_stored(session: Path, sample: str) -> bool:
    """Whether a sample is whole and durable; raises OSError if its name can't be made so."""
    path = session / label_path(sample)
    if not path.exists():
        return False
    sync_folder(path.parent)  # who wrote it may have died between the rename and this
    return True


def write_sample(
    session: Path,
    label: Label,
    pictures: Mapping[PictureKind, Picture],
    reserve: int,
    coding: Coding = LOSSLESS,
    watch: Stopwatch | None = None,
    *,
    kept: Mapping[PictureKind, StoredFile] | None = None,
) -> int:
    """Make a new sample durable; returns the bytes written.

    ``pictures``: ``rgb`` and ``original`` (H, W, 3) uint8 BGR, ``depth`` (H, W) uint16. The label's ``files``
    are filled in here; ``kept`` are those that are durable in the session already. Raises RefusedError
    (``disk_full`` before the disk is really full, ``bad_sample``) and OSError; whatever there is of the sample is
    removed then.
    """
    watch = watch or Stopwatch()
    encoded = {kind: coding.encode(kind, picture) for kind, picture in pictures.items()}
    watch.lap("encode")
    files = {kind: _stored(kind, label.sample, coding, data) for kind, data in encoded.items()}
    named = SampleFiles.model_validate({**files, **(kept or {})})
    text = _readable_text(label.model_copy(update={"files": named}))
    watch.lap("describe")
    total = sum(file.size for file in files.values()) + len(text)
    require_room(session, total, reserve)
    try:
        for kind, data in encoded.items():
            if kind == "original":  # made when it is first needed: `keep_original` may come with a reload
                (session / kind).mkdir(exist_ok=True)
            write_bytes(session / files[kind].path, data)
        write_bytes(session / label_path(label.sample), text)
    except BaseException:
        discard(session, label.sample, coding)
        raise
    watch.lap("write")
    return total


def paths_of(sample: str, kinds: Iterable[PictureKind], coding: Coding = LOSSLESS) -> dict[PictureKind, str]:
    """Where such pictures of a sample lie in its session."""
    return {kind: str(picture_path(kind, sample, coding.extension(kind))) for kind in kinds}


def discard(session: Path, sample: str, coding: Coding = LOSSLESS) -> None:
    """Remove what there is of a sample, its label first; what a broken disk keeps is left to the recovery."""
    for path in _every_path(session, sample, coding):
        for leftover in (path, temporary_path(path)):
            with contextlib.suppress(OSError):
                leftover.unlink(missing_ok=True)


def _every_path(session: Path, sample: str, coding: Coding) -> Iterable[Path]:
    yield session / label_path(sample)
    for kind in PICTURES:
        yield session / picture_path(kind, sample, coding.extension(kind))


def _stored(kind: PictureKind, sample: str, coding: Coding, data: bytes) -> StoredFile:
    path = picture_path(kind, sample, coding.extension(kind))
    return StoredFile(path=str(path), size=len(data), sha256=hashlib.sha256(data).hexdigest())


def _readable_text(label: Label) -> bytes:
    """The label as JSON that can be read back: NaN and infinity, which JSON doesn't have, are refused here."""
    text = label.model_dump_json(by_alias=True, indent=1)
    try:
        Label.model_validate_json(text)
    except ValidationError as error:
        where = ".".join(str(part) for part in error.errors(include_url=False)[0]["loc"])
        raise RefusedError(
            f"the label of {label.sample} has no finite number at {where}; this is a bug in the label service",
            code=BAD_SAMPLE,
        ) from error
    return text.encode() + b"\n"


def pictures_for(label: Label, slot: Pictures) -> dict[PictureKind, Picture]:
    """The pictures of a sample from its slot (``bgr``, ``depth``, ``original``); raises RefusedError ``bad_sample``."""
    size = (label.camera.height, label.camera.width)
    pictures: dict[PictureKind, Picture] = {"rgb": slot.bgr}
    if label.depth is not None:
        if slot.depth is None:
            raise RefusedError(
                f"the label of {label.sample} promises a depth picture, its pixels have none", code=BAD_SAMPLE
            )
        pictures["depth"] = slot.depth
    if slot.original is not None:
        pictures["original"] = slot.original
    for kind, picture in pictures.items():
        if picture.shape[:2] != size:
            raise RefusedError(
                f"the {kind} picture of {label.sample} has {picture.shape[1]}x{picture.shape[0]} pixels, "
                f"its label says {size[1]}x{size[0]}",
                code=BAD_SAMPLE,
            )
    return pictures
