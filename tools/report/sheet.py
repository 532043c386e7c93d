"""Contact sheets: one row a sample, one column a view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
_GROUND = (249, 247, 246)
_INK = (31, 24, 20)
_MUTED = (97, 83, 74)
_GAP = 12
_CAPTION = 26


@dataclass(frozen=True)
class Row:
    """The pictures of one sample, all of one size, with a caption."""

    pictures: tuple[Picture, ...]
    caption: str


def contact_sheet(
    title: str, columns: Sequence[str], rows: Sequence[Row], *, across: int = 2, width: int = 480
) -> Picture:
    """A sheet (H, W, 3) with ``across`` samples beside each other, each picture ``width`` px wide."""
    if not rows:
        raise ValueError("a contact sheet needs at least one sample")
    height = max(round(width * row.pictures[0].shape[0] / row.pictures[0].shape[1]) for row in rows)
    block_width = len(columns) * width + (len(columns) - 1) * 4
    lines = -(-len(rows) // across)
    top = 84
    sheet = np.full(
        (top + lines * (height + _CAPTION + _GAP) + _GAP, _GAP + across * (block_width + 2 * _GAP), 3),
        _GROUND,
        dtype=np.uint8,
    )
    cv2.putText(sheet, title, (_GAP, 38), cv2.FONT_HERSHEY_DUPLEX, 0.95, _INK, 1, cv2.LINE_AA)
    for block in range(min(across, len(rows))):
        for column, name in enumerate(columns):
            x = _GAP + block * (block_width + 2 * _GAP) + column * (width + 4)
            cv2.putText(sheet, name, (x, 72), cv2.FONT_HERSHEY_DUPLEX, 0.6, _MUTED, 1, cv2.LINE_AA)
    for index, row in enumerate(rows):
        x = _GAP + (index % across) * (block_width + 2 * _GAP)
        y = top + (index // across) * (height + _CAPTION + _GAP)
        for column, picture in enumerate(row.pictures):
            fitted = _fit(picture, width, height)
            left = x + column * (width + 4)
            sheet[y : y + fitted.shape[0], left : left + fitted.shape[1]] = fitted
        cv2.putText(sheet, row.caption, (x, y + height + 18), cv2.FONT_HERSHEY_DUPLEX, 0.45, _MUTED, 1, cv2.LINE_AA)
    return sheet


def _fit(picture: Picture, width: int, height: int) -> Picture:
    scale = min(width / picture.shape[1], height / picture.shape[0])
    size = (max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
