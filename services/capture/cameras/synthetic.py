"""The ``synthetic`` driver: a camera that looks at the rig's objects in the renderer's room, with ground truth."""

from __future__ import annotations

import numpy as np

from common.boards import read_board
from common.config import Rig
from common.config.models import CameraConfig, SyntheticOptions
from common.errors import CameraError
from common.geometry import CameraModel
from common.labels import CameraLabel
from common.markers import family
from common.scene import Rendered, Scene, SceneCamera, burn_number
from services.capture.cameras.base import Description, EndOfStreamError, Grabbed
from services.capture.cameras.intrinsics import fit_to_size, label_of
from services.capture.cameras.options import read_options
from services.capture.cameras.pacing import Pacer

SIZE = (1280, 720)
FPS = 30.0
FOCAL_PER_WIDTH = 0.72
"""921.6 px at 1280: a horizontal field of view of 69.5 degrees, as of a RealSense's colour camera."""


class SyntheticCamera:
    """Renders the next frame when it is due, or one of a path rendered ahead (``prerendered``), there and back.

    Gives as many frames as it can where it can't keep its rate. See ``SyntheticOptions`` for its keys.
    """

    def __init__(self, name: str, config: CameraConfig, rig: Rig) -> None:
        self._options = options = read_options(name, config, SyntheticOptions)
        self._cable = None if options.cable is None else rig.resolve(options.cable)
        self._check_cable()
        self._fps = config.fps or FPS
        self._label, self._warnings = _intrinsics(name, config, options, rig)
        model = CameraModel.from_label(self._label)
        matrix = model.matrix
        frustum = (model.width / 2 / float(matrix[0, 0]), model.height / 2 / float(matrix[1, 1]))
        scene = Scene(
            rig.boxes,
            family(rig.config.markers.family, rig.folder),
            options.seed,
            frustum=frustum,
            distance_mm=options.distance_mm,
            speed=options.speed,
            clutter=options.clutter,
            light=options.light,
            board=None if options.board is None else read_board(rig.resolve(options.board)),
        )
        self._camera = SceneCamera(scene, model, view_deg=options.view)
        self._next = 0
        self._ahead = [self._render(index * 30 / self._fps) for index in range(options.prerendered)]
        self._pacer = Pacer(self._fps)
        self._paced = options.pace == "consumer"

    def grab(self, timeout_s: float) -> Grabbed:
        """See Camera."""
        self._check_cable()
        if self._options.frames is not None and self._next >= self._options.frames:
            raise EndOfStreamError(f"{self._label.name}: all {self._options.frames} frames were given")
        if not self._paced and not self._pacer.wait(timeout_s):
            raise TimeoutError(f"{self._label.name}: the next frame is due later ({self._fps:g} frames/s)")
        rendered = self._frame(self._next)
        bgr = rendered.bgr
        if self._options.burn_frame:
            bgr = bgr.copy()
            burn_number(bgr, self._next)
        grabbed = Grabbed(bgr, rendered.depth, int(self._next * 1e9 / self._fps), truth=rendered.truth)
        self._next += 1
        return grabbed

    def describe(self) -> Description:
        """See Camera."""
        depth_unit_mm = 1.0 if self._options.depth else None
        return Description(self._label, self._fps, depth_unit_mm, paced=self._paced, warnings=self._warnings)

    def close(self) -> None:
        """See Camera; nothing is held."""
        self._ahead = []

    def _check_cable(self) -> None:
        if self._cable is not None and self._cable.exists():
            raise CameraError(f"the synthetic camera is unplugged; remove the file {self._cable} to plug it in again")

    def _frame(self, number: int) -> Rendered:
        ahead = self._ahead
        if not ahead:
            return self._render(number * 30 / self._fps)
        turn = max(2 * len(ahead) - 2, 1)
        step = number % turn
        return ahead[step if step < len(ahead) else turn - step]

    def _render(self, index: float) -> Rendered:
        options = self._options
        return self._camera.render(
            index, markers=options.markers, noise=options.noise, blur_px=options.blur_px, depth=options.depth
        )


def _intrinsics(
    name: str, config: CameraConfig, options: SyntheticOptions, rig: Rig
) -> tuple[CameraLabel, tuple[str, ...]]:
    """The calibration's, if the rig gives one; else those of the keys, which are the truth. What to say of them."""
    known = rig.calibration(name)
    if known is not None:
        return fit_to_size(known, config.width or known.width, config.height or known.height)
    width, height = config.width or SIZE[0], config.height or SIZE[1]
    focal = options.focal_px or FOCAL_PER_WIDTH * width
    matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    model = CameraModel(width, height, matrix, np.array(options.distortion or (0.0,) * 5))
    return label_of(name, model, intrinsics_from="truth", serial=f"synthetic-{options.seed}"), ()
