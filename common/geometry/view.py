"""From where an object is looked at: the direction to the camera in the object's own frame."""

from __future__ import annotations

import math

from common.labels import Row4

Matrix4 = tuple[Row4, Row4, Row4, Row4]


def view_direction(matrix: Matrix4) -> tuple[float, float]:
    """Azimuth and elevation (deg) of the camera as seen from the object's centre.

    ``matrix``: object frame to camera frame, 4x4 (a label's ``pose.matrix``). Azimuth is 0 before the front and grows
    towards the right side (90 right, -90 left, 180 behind), within (-180, 180]; elevation is 90 above the top.
    Where the camera is straight above or below, the azimuth is 0.
    """
    tx, ty, tz = (row[3] for row in matrix[:3])
    # The camera's place in the object's frame is -R'T; plain arithmetic, since 10,000 labels are read at a start.
    x, y, z = (-(matrix[0][i] * tx + matrix[1][i] * ty + matrix[2][i] * tz) for i in range(3))
    across = math.hypot(x, y)
    if across == 0.0:
        return 0.0, math.copysign(90.0, z) if z else 0.0
    azimuth = math.degrees(math.atan2(x, -y))
    return (180.0 if azimuth == -180.0 else azimuth), math.degrees(math.atan2(z, across))
