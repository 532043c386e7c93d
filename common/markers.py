"""Marker families: every dictionary that cv2 knows by name, and custom dictionaries from a file.

Corners and bit patterns leave this module in the marker's *own* upright frame. cv2 keeps its AprilTag
dictionaries turned by 180 degrees against the frame that AprilTag itself defines (and draws them upside
down), hence ``Family.bitmap`` and ``Family.own_order``.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from common.bounded import read_bytes
from common.errors import ConfigError
from common.file_storage import parse_file_storage

Bitmap = NDArray[np.uint8]

MAX_FILE_BYTES = 1 << 20
MAX_IDS = 4096
MAX_SIDE = 16
"""Of a custom dictionary; the largest that anybody publishes has 2,320 ids, or 8 bits along a side."""

_PREFIX = "DICT_"
_FILE_SUFFIXES = (".yml", ".yaml", ".xml", ".json")
# AprilTag's own names; people who come from its library write these.
_ALIASES = {
    "tag16h5": "apriltag_16h5",
    "tag25h9": "apriltag_25h9",
    "tag36h10": "apriltag_36h10",
    "tag36h11": "apriltag_36h11",
}


def _predefined() -> dict[str, int]:
    """Lower-case name without ``DICT_`` to cv2's number, of all dictionaries that this cv2 has."""
    return {
        name.removeprefix(_PREFIX).lower(): int(getattr(cv2.aruco, name))
        for name in dir(cv2.aruco)
        if name.startswith(_PREFIX)
    }


@dataclass(frozen=True, eq=False)
class Family:
    """A set of markers.

    ``name`` is the canonical name (``apriltag_36h11``, ``4x4_50``) or the file as it was given, ``ids`` how
    many markers there are (ids 0 ... ids-1), ``bits`` the data bits along one side (without the black
    border of one bit), ``apriltag`` whether cv2 keeps them turned by 180 degrees.
    """

    name: str
    ids: int
    bits: int
    apriltag: bool
    dictionary: cv2.aruco.Dictionary

    @property
    def cells(self) -> int:
        """Bits along a side of the black square, its border included."""
        return self.bits + 2

    @property
    def own_order(self) -> tuple[int, int, int, int]:
        """Indices that turn cv2's corner order (TL TR BR BL of cv2's frame) into the marker's own."""
        return (2, 3, 0, 1) if self.apriltag else (0, 1, 2, 3)

    def bitmap(self, marker: int) -> Bitmap:
        """The marker's cells (bits+2, bits+2), uint8, 0 black and 1 white, upright, row 0 = top.

        The black border of one cell is included, the white margin around it isn't.
        Raises ValueError for an id that the family doesn't have.
        """
        if not 0 <= marker < self.ids:
            raise ValueError(f"{self.name} has the ids 0 to {self.ids - 1}, not {marker}")
        drawn = cv2.aruco.generateImageMarker(self.dictionary, marker, self.cells, borderBits=1)
        cells: Bitmap = (np.asarray(drawn, dtype=np.uint8).reshape(self.cells, self.cells) > 127).astype(np.uint8)
        return np.ascontiguousarray(cells[::-1, ::-1]) if self.apriltag else cells

    @cached_property
    def distance(self) -> int:
        """The least Hamming distance between two ids in any turn, and between one and its own turns."""
        return _least_distance(self.dictionary)


def family(name_or_path: str, folder: Path) -> Family:
    """The family of this name, or of a dictionary file (path relative to ``folder``).

    Names are cv2's predefined dictionaries in any case, with or without ``DICT_``; AprilTag's own names
    (``tag36h11``) are understood too. A file is an OpenCV FileStorage file with ``nmarkers``,
    ``markersize`` and ``marker_0`` ... as cv2 writes it. Raises ConfigError.
    """
    text = name_or_path.strip()
    known = _predefined()
    name = _canonical(text)
    if name in known:
        dictionary = cv2.aruco.getPredefinedDictionary(known[name])
        return Family(name, len(dictionary.bytesList), dictionary.markerSize, name.startswith("apriltag_"), dictionary)
    if is_dictionary_file(text, folder):
        dictionary = _read(folder / text)
        return Family(text, len(dictionary.bytesList), dictionary.markerSize, False, dictionary)
    raise ConfigError(_unknown(text, name, (*known, *_ALIASES)))


def is_dictionary_file(name_or_path: str, folder: Path) -> bool:
    """Whether this means a dictionary file (path relative to ``folder``) and not a predefined family."""
    text = name_or_path.strip()
    if not text or is_predefined(text):
        return False
    return Path(text).suffix.lower() in _FILE_SUFFIXES or "/" in text or (folder / text).is_file()


def is_predefined(name: str) -> bool:
    """Whether ``family`` knows this name without reading a file."""
    return _canonical(name.strip()) in _predefined()


def _canonical(text: str) -> str:
    name = text.lower().removeprefix(_PREFIX.lower())
    return _ALIASES.get(name, name)


def names() -> tuple[str, ...]:
    """The canonical names of all predefined families."""
    return tuple(sorted(_predefined()))


def _unknown(text: str, name: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(name, list(known), n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(near)}?" if near else f"known are {', '.join(names())}."
    return f"there is no marker family '{text}'; {hint} A custom dictionary is given by its file (.yml)."


def _read(path: Path) -> cv2.aruco.Dictionary:
    """A dictionary from a FileStorage file; raises ConfigError that says what is wrong with the file."""
    if not path.is_file():
        raise ConfigError(f"the marker dictionary file {path} does not exist")
    try:
        text = read_bytes(path, MAX_FILE_BYTES).decode()
        plain = parse_file_storage(text)
    except OSError as error:
        raise ConfigError(f"the marker dictionary file {path} can't be read: {error.strerror}") from error
    except ValueError as error:
        why = "it is no text" if isinstance(error, UnicodeDecodeError) else str(error)
        raise ConfigError(f"{path} is no OpenCV FileStorage file with a marker dictionary: {why}") from error
    if not plain:
        raise ConfigError(f"{path} is no OpenCV FileStorage file (such a YAML file begins with '%YAML:1.0')")
    bits = _bits(plain)
    if bits is None:
        raise ConfigError(
            f"{path} is no marker dictionary: it needs nmarkers (at most {MAX_IDS}), markersize (at most {MAX_SIDE}) "
            "and marker_0 ... marker_<nmarkers-1>, each a quoted text of markersize x markersize characters 0 or 1"
        )
    packed = [cv2.aruco.Dictionary.getByteListFromBits(one) for one in bits]
    given = plain.get("maxCorrectionBits")
    dictionary = cv2.aruco.Dictionary(np.vstack(packed), bits.shape[1], 0)
    distance = _least_distance(dictionary)
    if distance < 1:
        raise ConfigError(
            f"{path} is no usable marker dictionary: two of its markers are alike, or one is like itself turned"
        )
    # A file may leave it out; what can be corrected without doubt follows from the patterns.
    most = (distance - 1) // 2
    dictionary.maxCorrectionBits = given if type(given) is int and 0 < given <= bits[0].size else most
    return dictionary


def _bits(plain: dict[str, Any]) -> Bitmap | None:
    """The markers' patterns (ids, side, side), 0 and 1; None if they aren't all there."""
    count, side = plain.get("nmarkers"), plain.get("markersize")
    if type(count) is not int or type(side) is not int or not (1 <= count <= MAX_IDS and 1 <= side <= MAX_SIDE):
        return None
    texts = [plain.get(f"marker_{marker}") for marker in range(count)]
    if not all(isinstance(text, str) and len(text) == side * side and set(text) <= {"0", "1"} for text in texts):
        return None
    return np.array([[int(bit) for bit in text] for text in texts if text], dtype=np.uint8).reshape(count, side, side)


def _least_distance(dictionary: cv2.aruco.Dictionary) -> int:
    size = dictionary.markerSize
    turned = np.array(
        [
            [np.rot90(bits, turn).ravel() for turn in range(4)]
            for bits in (
                np.asarray(dictionary.getMarkerBits(marker)).reshape(size, size)
                for marker in range(len(dictionary.bytesList))
            )
        ],
        dtype=np.float32,
    )
    upright = turned[:, 0]
    least = float(size * size)
    for turn in range(4):
        other = turned[:, turn]
        distances = upright.sum(1)[:, None] + other.sum(1)[None, :] - 2 * upright @ other.T
        if turn == 0:
            np.fill_diagonal(distances, np.inf)
        least = min(least, float(distances.min()))
    return round(least)
