"""What is found out of a session's samples, one by one. Plain frozen values that travel between processes.

Pixels, millimetres and degrees, as everywhere. None: it could not be measured (no depth picture, say).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

ProblemKind = Literal[
    "label", "missing_file", "damaged", "wrong_size", "contradiction", "orphan", "temporary", "session", "ledger"
]
BROKEN: tuple[ProblemKind, ...] = ("label", "missing_file", "damaged", "wrong_size")
"""What makes a sample useless: `--repair` moves it to the bin."""
STRAY: tuple[ProblemKind, ...] = ("orphan", "temporary")
"""Files without a sample: `--repair` moves them to the quarantine."""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong: of a sample, or (None) of the session. ``path`` is relative to the session."""

    kind: ProblemKind
    sample: str | None
    path: str
    message: str


@dataclass(frozen=True, eq=False)
class ObjectFacts:
    """One object of one sample. ``class_name``: of its side that faces the camera most.

    ``window`` (4,): x_min y_min x_max y_max, unclipped; ``pose`` (4, 4): object to camera frame. ``off_px``: how far
    the label's corners are from where its own pose puts them; ``wrong``: what contradicts the rig, in words.
    ``depth_mm``: median distance of the measured surface from the pose's, along the optical axis; ``depth_signed_mm``
    with its sign. ``outline``: by how many standard deviations the picture has more edge along the projected outline
    than elsewhere around it. ``pattern``: the best correlation of what is left of a marker with its bits, and which
    marker. ``erased``: the share of the window (clipped) that was erased.
    """

    name: str
    type: str
    class_name: str
    distance_mm: float
    angle_deg: float
    azimuth_deg: float
    elevation_deg: float
    window: NDArray[np.float64]
    pose: NDArray[np.float64]
    whole: bool
    residual_px: float
    corner_sigma_px: float | None
    distance_sigma_mm: float | None
    ambiguous: bool
    off_px: float
    wrong: tuple[str, ...]
    depth_mm: float | None
    depth_signed_mm: float | None
    outline: float | None
    pattern: float
    pattern_marker: int | None
    erased: float


@dataclass(frozen=True, eq=False)
class Facts:
    """One sample. ``problems`` of its files; without a readable label and picture nothing else is known.

    ``pixels``: a checksum of the stored picture's pixels.
    ``remains``: markers that the detector finds in the stored picture. ``original_px``: median distance of an
    object's labelled marker corners from those in the picture as captured; ``changed``: the share of pixels outside
    of the erased regions that differ from it.
    """

    sample: str
    camera: str
    problems: tuple[Problem, ...] = ()
    readable: bool = False
    recording: str | None = None
    wall_ns: int = 0
    complete: bool = True
    background: bool = False
    blur: float = 0.0
    brightness: float = 0.0
    clipped: float = 0.0
    alike: int = 0
    pixels: int | None = None
    remains: tuple[int, ...] = ()
    original_px: float | None = None
    changed: float | None = None
    bytes: int = 0
    objects: tuple[ObjectFacts, ...] = ()


@dataclass(frozen=True)
class Reason:
    """Why a sample is suspicious: a word for programs, a sentence, and how much (1 = just so)."""

    kind: str
    text: str
    score: float


@dataclass(frozen=True, eq=False)
class Suspect:
    """A sample with its reasons, the strongest first."""

    facts: Facts
    reasons: tuple[Reason, ...]

    @property
    def score(self) -> float:
        """The strongest reason counts, the others decide between equals."""
        first, *others = [reason.score for reason in self.reasons] or [0.0]
        return first + 0.1 * sum(others)
