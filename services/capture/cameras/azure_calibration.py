"""An Azure Kinect's calibration: intrinsics of both cameras, and depth moved into the colour camera's picture.

The file (CALIBRATION_LensDistortionModelBrownConrady) gives cx, cy, fx, fy as shares of the whole sensor with (0, 0) at
the first pixel's *corner*, then k1 ... k6, codx, cody, p2, p1; the modes bin and crop the sensor. Facts:
microsoft/Azure-Kinect-Sensor-SDK, src/transformation/mode_specific_calibration.c.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.bounded import parse_json
from common.errors import CameraError
from common.geometry import CameraModel

# Picture size: the binned sensor's size, and what is cut off at its left and top.
_DEPTH_MODES = {
    (320, 288): ((512, 512), (96, 90)),
    (640, 576): ((1024, 1024), (192, 180)),
    (512, 512): ((512, 512), (0, 0)),
    (1024, 1024): ((1024, 1024), (0, 0)),
}
_COLOUR_MODES = {
    (1280, 720): ((1280, 960), (0, 120)),
    (1920, 1080): ((1920, 1440), (0, 180)),
    (2560, 1440): ((2560, 1920), (0, 240)),
    (2048, 1536): ((2048, 1536), (0, 0)),
    (3840, 2160): ((3840, 2880), (0, 360)),
    (4096, 3072): ((4096, 3072), (0, 0)),
}
_PARAMETERS = 14
_CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


@dataclass(frozen=True)
class AzureCalibration:
    """Both cameras and ``rotation`` (3, 3), ``translation`` (3,) mm from the depth camera's frame to colour's."""

    colour: CameraModel
    depth: CameraModel
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]


def read_calibration(text: bytes, colour: tuple[int, int], depth: tuple[int, int]) -> AzureCalibration:
    """The calibration (JSON) for pictures of these sizes (w, h); raises CameraError for one that it doesn't fit."""
    try:
        cameras = {one["Location"]: one for one in parse_json(text.rstrip(b"\0"))["CalibrationInformation"]["Cameras"]}
        of_depth, of_colour = cameras["CALIBRATION_CameraLocationD0"], cameras["CALIBRATION_CameraLocationPV0"]
        place = of_colour["Rt"]
        return AzureCalibration(
            _model(of_colour, colour, _COLOUR_MODES),
            _model(of_depth, depth, _DEPTH_MODES),
            np.array(place["Rotation"], dtype=np.float64).reshape(3, 3),
            1000 * np.array(place["Translation"], dtype=np.float64).reshape(3),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise CameraError(f"the recording's calibration can't be read: {type(error).__name__} {error}") from error


class Reprojection:
    """Moves depth pictures of one calibration into the colour picture; what never changes is computed once."""

    def __init__(self, calibration: AzureCalibration) -> None:
        self._colour = calibration.colour
        self._translation = calibration.translation
        height, width = calibration.depth.height, calibration.depth.width
        y, x = np.mgrid[:height, :width].astype(np.float64)
        centres = np.column_stack([x.ravel(), y.ravel()])
        # A depth pixel is a small square: where its corners fall is what it covers in the finer colour picture.
        self._rays = [
            _rays(calibration.depth, centres + corner) @ calibration.rotation.T for corner in (np.zeros(2), *_CORNERS)
        ]

    def align(self, depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """``depth`` (h, w) uint16 mm along the depth camera's axis as (H, W) uint16 mm along colour's; 0 = unknown.

        Each pixel's square is drawn as the box around its four corners; where several lie over each other the
        nearest wins. Colour pixels that no depth pixel covers stay 0.
        """
        z = depth.ravel().astype(np.float64)
        known = z > 0
        centre = self._rays[0][known] * z[known, None] + self._translation
        corners = [self._seen(rays[known], z[known]) for rays in self._rays[1:]]
        us, vs = np.array([uv[:, 0] for uv in corners]), np.array([uv[:, 1] for uv in corners])
        whole = np.isfinite(us).all(axis=0) & np.isfinite(vs).all(axis=0) & (centre[:, 2] > 0)
        first_u, last_u = _pixels(us[:, whole])
        first_v, last_v = _pixels(vs[:, whole])
        return self._painted(centre[whole, 2], first_u, last_u, first_v, last_v)

    def _seen(self, rays: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._colour.project(rays * z[:, None] + self._translation)[0]

    def _painted(
        self,
        z: NDArray[np.float64],
        first_u: NDArray[np.intp],
        last_u: NDArray[np.intp],
        first_v: NDArray[np.intp],
        last_v: NDArray[np.intp],
    ) -> NDArray[np.uint16]:
        width, height = self._colour.width, self._colour.height
        far = np.iinfo(np.uint16).max
        picture = np.full(height * width, far, np.uint16)
        values = np.clip(np.rint(z), 1, far - 1).astype(np.uint16)
        for down in range(int((last_v - first_v).max(initial=-1)) + 1):
            for across in range(int((last_u - first_u).max(initial=-1)) + 1):
                u, v = first_u + across, first_v + down
                inside = (u <= last_u) & (v <= last_v) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
                np.minimum.at(picture, v[inside] * width + u[inside], values[inside])
        picture[picture == far] = 0
        return picture.reshape(height, width)


def _rays(camera: CameraModel, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Directions (N, 3) with z = 1; NaN where the lens sees nothing."""
    found = camera.normalise(pixels)
    return np.column_stack([found, np.ones(len(found))])


def _pixels(edges: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last pixel whose centre lies between the least and the greatest of ``edges`` (4, N).

    Widened by half a pixel: neighbours of slightly different depth drift apart, and no crack may open between them.
    """
    least, greatest = edges.min(axis=0) - 0.5, edges.max(axis=0) + 0.5
    return np.ceil(least).astype(np.intp), np.floor(greatest).astype(np.intp)


def _model(
    camera: dict[str, Any],
    size: tuple[int, int],
    modes: dict[tuple[int, int], tuple[tuple[int, int], tuple[int, int]]],
) -> CameraModel:
    if size not in modes:
        raise ValueError(f"there is no mode of {size[0]}x{size[1]} pixels")
    parameters = [float(value) for value in camera["Intrinsics"]["ModelParameters"]]
    if len(parameters) != _PARAMETERS or not camera["Intrinsics"]["ModelType"].endswith("BrownConrady"):
        raise ValueError(f"the lens model {camera['Intrinsics']['ModelType']} is unknown")
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = parameters
    (wide, high), (left, top) = modes[size]
    if camera["SensorWidth"] * 9 == camera["SensorHeight"] * 16 and modes is _COLOUR_MODES:
        cy, fy = (cy * 2304 + 384) / 3072, fy * 2304 / 3072  # early files are for the sensor's middle, 4096x2304
    matrix = np.array([[fx * wide, 0, cx * wide - left - 0.5], [0, fy * high, cy * high - top - 0.5], [0, 0, 1]])
    return CameraModel(*size, matrix, np.array([k1, k2, p1, p2, k3, k4, k5, k6]))
