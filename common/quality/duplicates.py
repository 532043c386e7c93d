"""Near-duplicates: pictures that look alike *and* show their objects from the same place.

Neither alone will do. A small object in an empty room gives almost the same picture wherever it stands; the same
pose before another background is a picture worth having.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import Pose

ALIKE_BITS = 10
"""Hashes that differ in more of their bits are of different pictures."""
ALIKE_DEG = 6.0
ALIKE_SHARE = 0.04
"""Of the distance: an object that moved further (4 %, some 40 px before the usual lens) is elsewhere."""
_SIDE = 32


def perceptual_hash(picture: NDArray[np.uint8]) -> int:
    """64 bits of a picture (H, W) or (H, W, 3) that noise, size and compression hardly change.

    Method: the signs of the 8x8 lowest frequencies of the cosine transform of the picture at 32x32, against their
    median (Zauner, "Implementation and benchmarking of perceptual image hash functions", 2010, section 3.2.1).
    """
    grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    small = cv2.resize(grey, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA).astype(np.float32)
    low = np.asarray(cv2.dct(small))[1:9, 1:9].ravel()
    bits = low > np.median(low)
    return int.from_bytes(np.packbits(bits).tobytes(), "big")


def differing_bits(one: int, others: NDArray[np.uint64]) -> NDArray[np.int64]:
    """In how many of 64 bits a hash differs from each of others (N,); returns (N,)."""
    different = np.ascontiguousarray(others ^ np.uint64(one)).view(np.uint8).reshape(-1, 8)
    return np.asarray(np.unpackbits(different, axis=1).sum(axis=1), dtype=np.int64)


View = Mapping[str, Pose]
"""From where a camera sees its objects: object to camera frame, by the object's name."""


def near_views(views: Sequence[View], others: Sequence[View]) -> NDArray[np.bool_]:
    """Which pairs show the same objects, each turned by under 6 degrees and moved by under 4 % of its distance.

    Returns (len(views), len(others)). Views without any object are near: only their pictures can tell them apart.
    """
    near = np.zeros((len(views), len(others)), dtype=bool)
    rows, columns = _by_objects(views), _by_objects(others)
    for names, row in rows.items():
        column = columns.get(names)
        if column is None:
            continue
        alike = np.ones((len(row), len(column)), dtype=bool)
        for name in sorted(names):
            first, second = [views[i][name] for i in row], [others[i][name] for i in column]
            alike &= _near_poses(first, second)
        near[np.ix_(row, column)] = alike
    return near


def _by_objects(views: Sequence[View]) -> dict[frozenset[str], list[int]]:
    found: dict[frozenset[str], list[int]] = {}
    for index, view in enumerate(views):
        found.setdefault(frozenset(view), []).append(index)
    return found


def _near_poses(first: Sequence[Pose], second: Sequence[Pose]) -> NDArray[np.bool_]:
    """Pairs (N, M) of poses of one object that are near."""
    turned = (
        np.array([pose.rotation.ravel() for pose in first]) @ np.array([pose.rotation.ravel() for pose in second]).T
    )
    near: NDArray[np.bool_] = (turned - 1) / 2 > np.cos(np.radians(ALIKE_DEG))
    at = np.array([pose.translation for pose in second])
    for row, pose in enumerate(first):
        limit = ALIKE_SHARE * float(np.linalg.norm(pose.translation))
        near[row] &= np.linalg.norm(at - pose.translation, axis=1) < limit
    return near
