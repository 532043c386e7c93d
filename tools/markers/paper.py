"""Papers by name or size, and what of them a printer reaches."""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass

UNPRINTABLE_MM = 6.4
"""A quarter of an inch: hardly a printer leaves more white than that at the sides."""
UNPRINTABLE_BELOW_MM = 12.7
"""Half an inch: what the feed of many ink-jet printers leaves white at the bottom."""

_LARGEST_MM = 3000.0
_SMALLEST_MM = 125.0
"""The 100 mm ruler with its margins must fit."""


@dataclass(frozen=True, slots=True)
class Paper:
    """A sheet of paper, mm."""

    name: str
    width: float
    height: float

    @property
    def area(self) -> float:
        """mm²."""
        return self.width * self.height

    @property
    def upright(self) -> Paper:
        """In portrait format."""
        return Paper(self.name, min(self.width, self.height), max(self.width, self.height))

    @property
    def lying(self) -> Paper:
        """In landscape format."""
        return Paper(self.name, max(self.width, self.height), min(self.width, self.height))


SERIES: tuple[tuple[Paper, ...], ...] = (
    (
        Paper("A5", 148, 210),
        Paper("A4", 210, 297),
        Paper("A3", 297, 420),
        Paper("A2", 420, 594),
        Paper("A1", 594, 841),
        Paper("A0", 841, 1189),
    ),
    (Paper("Letter", 215.9, 279.4), Paper("Legal", 215.9, 355.6), Paper("Tabloid", 279.4, 431.8)),
)
"""The papers known by name, each series from small to large."""


def parse_paper(text: str) -> Paper:
    """For argparse: a paper's name in any case, or its size in mm as ``WIDTHxHEIGHT``."""
    known = {paper.name.lower(): paper for series in SERIES for paper in series}
    if text.lower() in known:
        return known[text.lower()]
    size = re.fullmatch(r"(\d+(?:\.\d+)?)\s*[xX×]\s*(\d+(?:\.\d+)?)", text)
    if size is None:
        names = ", ".join(paper.name for paper in known.values())
        raise argparse.ArgumentTypeError(f"'{text}' is no paper; one of {names}, or its size in mm such as 210x297")
    width, height = float(size[1]), float(size[2])
    if min(width, height) < _SMALLEST_MM or max(width, height) > _LARGEST_MM:
        raise argparse.ArgumentTypeError(f"a paper of {text} mm: each side must be {_SMALLEST_MM:g} to {_LARGEST_MM:g}")
    return Paper(f"{width:g}x{height:g}", width, height)


def larger_than(paper: Paper) -> tuple[Paper, ...]:
    """The papers to try where this one is too small: the rest of its own series first, then the A series."""
    own = next((series for series in SERIES if paper in series), ())
    candidates = (*own, *SERIES[0])
    return tuple(dict.fromkeys(other for other in candidates if other.area > paper.area))
