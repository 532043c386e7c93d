"""Reading a session: one reader for the gallery, export, inspect and relabel."""

from __future__ import annotations

import hashlib
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from common.bounded import TooLargeError, read_bytes
from common.dataset.bin import bin_of
from common.dataset.layout import LABELS, PICTURES, PictureKind, label_path, sample_of_label
from common.dataset.session import SessionFile, parse_versioned, read_session, read_text
from common.errors import DatasetError
from common.labels import Label, StoredFile
from common.pictures import MOST_BYTES, decode


class SessionReader:
    """One session's folder. A sample exists when its label exists; its pictures are those the label names.

    Samples in the bin are none of the session's; ``bin`` reads those.
    """

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise DatasetError(f"{folder} is no session: there is no such folder", code="no_session")
        self.folder = folder

    @property
    def session(self) -> SessionFile:
        """``session.json`` as it is now; raises DatasetError."""
        return read_session(self.folder)

    @property
    def bin(self) -> SessionReader | None:
        """A reader of the samples that were deleted; None if none ever was."""
        folder = bin_of(self.folder)
        return SessionReader(folder) if folder.is_dir() else None

    def samples(self) -> tuple[str, ...]:
        """The names of all samples, oldest first (names begin with the UTC time)."""
        folder = self.folder / LABELS
        if not folder.is_dir():
            return ()
        return tuple(sorted(filter(None, (sample_of_label(path.name) for path in folder.iterdir()))))

    def label(self, sample: str) -> Label:
        """A sample's label; raises DatasetError, with code ``missing_file`` if there is no such sample."""
        path = self.folder / label_path(sample)
        return parse_versioned(Label, read_text(path), path)

    def colour(self, sample: str | Label) -> NDArray[np.uint8]:
        """The stored picture without markers, (H, W, 3) uint8 BGR."""
        return np.asarray(self._picture(sample, "rgb", cv2.IMREAD_COLOR), dtype=np.uint8)

    def original(self, sample: str | Label) -> NDArray[np.uint8] | None:
        """The picture as captured, (H, W, 3) uint8 BGR; None where the session doesn't keep it."""
        if self.stored(sample, "original") is None:
            return None
        return np.asarray(self._picture(sample, "original", cv2.IMREAD_COLOR), dtype=np.uint8)

    def depth(self, sample: str | Label) -> NDArray[np.uint16] | None:
        """The depth picture (H, W) uint16, ``label.depth.unit_mm`` mm a step, 0 invalid; None without depth."""
        if self.stored(sample, "depth") is None:
            return None
        picture = self._picture(sample, "depth", cv2.IMREAD_UNCHANGED)
        if picture.ndim != 2 or picture.dtype != np.uint16:
            raise DatasetError(
                f"the depth picture of {_name(sample)} is {picture.dtype} {picture.shape}, not (H, W) uint16"
            )
        return np.asarray(picture, dtype=np.uint16)

    def stored(self, sample: str | Label, kind: PictureKind) -> StoredFile | None:
        """What the label says of one of its files; raises DatasetError if it names no files at all."""
        label = self._label_of(sample)
        if label.files is None:
            raise DatasetError(f"the label of {label.sample} names no files; it never went through the store")
        found: StoredFile | None = getattr(label.files, kind)
        return found

    def path(self, file: StoredFile) -> Path:
        """Where a sample's file is; raises DatasetError for a path that leads out of the session."""
        path = (self.folder / file.path).resolve()
        if not path.is_relative_to(self.folder.resolve()):
            raise DatasetError(f"a label names {file.path}, which is outside of the session {self.folder}")
        return path

    def verify(self, sample: str | Label) -> None:
        """Check size and checksum of every file of a sample; raises DatasetError naming the first that differs."""
        label = self._label_of(sample)
        for kind in PICTURES:
            file = self.stored(label, kind)
            if file is None:
                continue
            path = self.path(file)
            data = _read_bytes(path)
            if len(data) != file.size:
                raise DatasetError(f"{path} has {len(data)} bytes, its label says {file.size}", code="damaged")
            if hashlib.sha256(data).hexdigest() != file.sha256:
                raise DatasetError(f"{path} was changed: its checksum is not the one in its label", code="damaged")

    def _label_of(self, sample: str | Label) -> Label:
        return sample if isinstance(sample, Label) else self.label(sample)

    def _picture(self, sample: str | Label, kind: PictureKind, flags: int) -> NDArray[np.generic]:
        file = self.stored(sample, kind)
        if file is None:
            raise DatasetError(f"sample {_name(sample)} has no {kind} picture")
        path = self.path(file)
        # decoded from bytes: cv2.imread prints its own warning and returns None for a missing file
        picture = decode(_read_bytes(path), flags)
        if picture is None:
            raise DatasetError(f"{path} is no picture that can be read; it is damaged", code="damaged")
        return picture


def _read_bytes(path: Path) -> bytes:
    try:
        data = read_bytes(path, MOST_BYTES)
    except FileNotFoundError:
        raise DatasetError(f"{path} is missing", code="missing_file") from None
    except TooLargeError as error:
        raise DatasetError(f"{path} can't be read: {error}", code="damaged") from error
    except OSError as error:
        raise DatasetError(f"{path} can't be read: {error}") from error
    if not data:
        raise DatasetError(f"{path} is empty", code="damaged")
    return data


def _name(sample: str | Label) -> str:
    return sample if isinstance(sample, str) else sample.sample
