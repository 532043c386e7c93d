"""Rigid transforms. A ``Pose`` named ``a_to_b`` turns coordinates of frame a into those of frame b."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.labels import PoseLabel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pose:
    """Rotation (3, 3) and translation (3,) in mm."""

    rotation: Array
    translation: Array

    @classmethod
    def identity(cls) -> Pose:
        """The pose that changes nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_rvec(cls, rvec: ArrayLike, tvec: ArrayLike) -> Pose:
        """From a Rodrigues vector (rad) and a translation (mm)."""
        rotation, _ = cv2.Rodrigues(np.asarray(rvec, dtype=np.float64).reshape(3))
        return cls(np.asarray(rotation, dtype=np.float64), np.asarray(tvec, dtype=np.float64).reshape(3))

    @property
    def rvec(self) -> Array:
        """The Rodrigues vector (3,), rad."""
        vector, _ = cv2.Rodrigues(self.rotation)
        return np.asarray(vector, dtype=np.float64).reshape(3)

    @property
    def matrix(self) -> Array:
        """The homogeneous matrix (4, 4)."""
        out = np.eye(4)
        out[:3, :3] = self.rotation
        out[:3, 3] = self.translation
        return out

    @property
    def finite(self) -> bool:
        """Whether all of it is."""
        return math.isfinite(float(self.rotation.sum() + self.translation.sum()))

    def apply(self, points: ArrayLike) -> Array:
        """Transform points (N, 3)."""
        xyz = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        moved: Array = xyz @ self.rotation.T + self.translation
        return moved

    def after(self, first: Pose) -> Pose:
        """``self`` applied after ``first``: (b_to_c).after(a_to_b) is a_to_c."""
        return Pose(self.rotation @ first.rotation, self.rotation @ first.translation + self.translation)

    def inverse(self) -> Pose:
        """The way back."""
        return Pose(self.rotation.T, -self.rotation.T @ self.translation)

    def angle_to(self, other: Pose) -> float:
        """The angle (rad) of the rotation between two poses."""
        cosine = (float(np.vdot(self.rotation, other.rotation)) - 1) / 2  # vdot: the trace of R1' R2
        return math.acos(min(max(cosine, -1.0), 1.0))

    def label(self) -> PoseLabel:
        """As it is written into labels."""
        rows = tuple(tuple(row) for row in self.matrix.tolist())
        return PoseLabel.model_validate(
            {"rvec": tuple(self.rvec.tolist()), "tvec_mm": tuple(self.translation.tolist()), "matrix": rows}
        )

    @classmethod
    def from_label(cls, label: PoseLabel) -> Pose:
        """The inverse of ``label``."""
        matrix = np.array(label.matrix)
        return cls(matrix[:3, :3], matrix[:3, 3])
