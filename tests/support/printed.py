"""Printed pages as a camera would like to see them: a PDF rendered by poppler, and where its words are."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

MM = 25.4


def need_poppler() -> None:
    """Skip the test where poppler's tools are missing; where CI says it has installed all, that is a failure."""
    missing = [tool for tool in ("pdftoppm", "pdftotext") if shutil.which(tool) is None]
    if missing and os.environ.get("CI") == "true":
        pytest.fail(f"{missing[0]} is missing; .ci/run installs poppler-utils")
    if missing:
        pytest.skip(f"{missing[0]} is missing; install poppler-utils")


def rendered(pdf: Path, dpi: int) -> list[NDArray[np.uint8]]:
    """The pages as grey pictures (H, W)."""
    root = pdf.with_suffix("") / f"{dpi}"
    root.mkdir(parents=True)
    subprocess.run(["pdftoppm", "-r", f"{dpi}", "-gray", str(pdf), str(root / "page")], check=True, timeout=60)
    pages = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(root.iterdir())]
    return [np.asarray(page, dtype=np.uint8) for page in pages if page is not None]


def to_mm(pixels: NDArray[np.float64], dpi: int) -> NDArray[np.float64]:
    """Pixel centres (integer = centre) to mm from the paper's corner."""
    return np.asarray((pixels + 0.5) / dpi * MM)


def words(pdf: Path) -> list[list[tuple[str, float, float]]]:
    """Each page's words in reading order with the left upper corner of each, mm."""
    done = subprocess.run(["pdftotext", "-bbox", str(pdf), "-"], check=True, timeout=60, capture_output=True, text=True)
    found = re.compile(r'<word xMin="([\d.]+)" yMin="([\d.]+)"[^>]*>([^<]*)</word>')
    return [
        [(text, float(x) / 72 * MM, float(y) / 72 * MM) for x, y, text in found.findall(page)]
        for page in done.stdout.split("<page ")[1:]
    ]


def runs(line: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Begin and end (exclusive) of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
