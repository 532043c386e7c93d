"""What labels are built of: the base of their models, and points, quadrilaterals, matrices as plain tuples."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

Point = tuple[float, float]
Vector3 = tuple[float, float, float]
Row4 = tuple[float, float, float, float]
Quad = tuple[Point, Point, Point, Point]
Matrix3 = tuple[Vector3, Vector3, Vector3]


class Part(BaseModel):
    """A frozen part of a label; unknown fields are refused.

    Pydantic keeps the last 16,000 strings that it has read, and no two labels have the same: they are read without.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True, cache_strings="keys")
