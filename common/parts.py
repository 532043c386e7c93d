"""What labels are built of: the base of their models, and points, quadrilaterals, matrices as plain tuples."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

Point = tuple[float, float]
Vector3 = tuple[float, float, float]
Row4 = tuple[float, float, float, float]
Quad = tuple[Point, Point, Point, Point]
Matrix3 = tuple[Vector3, Vector3, Vector3]


class Part(BaseModel):
    """A frozen part of a label; unknown fields are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)
