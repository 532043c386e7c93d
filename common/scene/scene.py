"""The scene and its cameras: objects on their paths, drawn with known truth, with or without markers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from common.boards import Board
from common.geometry import Box, CameraModel, Pose
from common.messages import TrueObject
from common.scene.backdrop import Backdrop
from common.scene.boards import BOARD, BoardDrawing, BoardPath
from common.scene.compose import Composer, merged, reach_of
from common.scene.light import Light
from common.scene.noise import NoiseBank
from common.scene.objects import BoxDrawing, Patterns, back_to_front
from common.scene.path import Path, Room
from common.scene.raster import Patch, Picture
from common.scene.rays import PixelRays
from common.scene.truth import true_objects

Depth = NDArray[np.uint16]
Quality = Literal["fast", "exact"]
DEFAULT_FRUSTUM = (0.694, 0.391)
"""Tangents of half the field of view of the synthetic camera's default: 1280x720, focal length 921.6 px."""
EXACT_PASSES = 4
_CAMERAS_KEPT = 3


@dataclass(frozen=True, eq=False)
class Rendered:
    """A frame: ``bgr`` (H, W, 3) uint8, ``depth`` (H, W) uint16 in mm (0 = nothing there), its truth.

    Depth is the distance along the optical axis of the visible surface.
    """

    bgr: Picture
    depth: Depth | None
    truth: tuple[TrueObject, ...]


class Scene:
    """Boxes with their markers on a seeded path in a seeded room.

    ``frustum``: tangents of half the horizontal and vertical field of view in which the path keeps the
    objects; ``distance_mm``: their mean distance (None: so that all fit); ``speed`` of their motion,
    ``clutter`` of the room 0..1, ``light`` how uneven and changing the light is, 0..1. A ``board`` is shown instead
    of the boxes. Two scenes made from the same arguments are the same, in any process.
    """

    def __init__(
        self,
        boxes: Sequence[Box],
        family: Patterns,
        seed: int = 1,
        *,
        frustum: tuple[float, float] = DEFAULT_FRUSTUM,
        distance_mm: float | None = None,
        speed: float = 1.0,
        clutter: float = 1.0,
        light: float = 1.0,
        board: Board | None = None,
    ) -> None:
        self.boxes = tuple(boxes) if board is None else ()
        self.seed = seed
        if board is not None:
            distance_mm = distance_mm or BoardPath.room_mm(board, frustum)
        self.light = Light(seed, light)
        self.room = Room(self.boxes, frustum, distance_mm)
        self.backdrop = Backdrop(self.room, frustum, seed, clutter)
        self.drawings = {box.name: BoxDrawing(box, family, seed) for box in self.boxes}
        self._paths = {box.name: Path(box, number, self.room, seed, speed) for number, box in enumerate(self.boxes)}
        self.board = None if board is None else BoardDrawing(board)
        self._board_path = None if board is None else BoardPath(board, frustum, seed, speed)
        self._cameras: list[SceneCamera] = []

    def poses(self, index: float) -> dict[str, Pose]:
        """Each object's pose at a frame number (30 to the second): object frame to scene frame; a board's as BOARD.

        The scene frame is the camera frame of a camera with ``view_deg`` 0.
        """
        poses = {name: path.pose(index) for name, path in self._paths.items()}
        return poses if self._board_path is None else poses | {BOARD: self._board_path.pose(index)}

    def viewpoint(self, view_deg: float) -> Pose:
        """Scene frame to camera frame for a camera that went round the scene's middle by so many degrees.

        Positive: to the right, as the first camera sees it; it looks at the middle from the same distance.
        """
        middle = np.array([0.0, 0.0, self.room.middle])
        turn = Pose.from_rvec([0.0, np.radians(view_deg), 0.0], np.zeros(3)).rotation
        return Pose(turn, middle - turn @ middle)

    def render(
        self,
        camera: CameraModel,
        poses: Mapping[str, Pose] | None = None,
        index: float = 0,
        *,
        markers: bool = True,
        noise: float = 2.0,
        blur_px: float = 0.6,
        depth: bool = True,
        depth_noise_mm: float = 1.0,
    ) -> Rendered:
        """A frame of a camera at the scene's origin: ``SceneCamera.render`` of one that is kept for ``camera``."""
        found = next((kept for kept in self._cameras if kept.camera is camera), None)
        if found is None:
            found = SceneCamera(self, camera)
            self._cameras = [*self._cameras[-(_CAMERAS_KEPT - 1) :], found]
        return found.render(
            index,
            poses,
            markers=markers,
            noise=noise,
            blur_px=blur_px,
            depth=depth,
            depth_noise_mm=depth_noise_mm,
        )


class SceneCamera:
    """A camera in a scene: what can be worked out once (rays, room, noise) is kept here.

    ``quality`` "fast" ramps edges over one pixel analytically; "exact" is for evaluation: it has the same
    geometry, but each pixel is the mean of 16 samples, about a tenth as fast.
    """

    def __init__(self, scene: Scene, camera: CameraModel, *, view_deg: float = 0.0, quality: Quality = "fast") -> None:
        self.scene = scene
        self.camera = camera
        self.from_scene = scene.viewpoint(view_deg)
        self._noise_seed = scene.seed + round(view_deg * 1000)
        self._banks: dict[str, tuple[float, NoiseBank]] = {}
        rays = PixelRays.of(camera)
        light = scene.light.field(camera.width, camera.height)
        empty, empty_depth = scene.backdrop.draw(rays, self.from_scene, light)
        self._composer = Composer(rays, empty, empty_depth, light, 1 if quality == "fast" else EXACT_PASSES)

    def poses(self, index: float) -> dict[str, Pose]:
        """Each object's pose on the scene's path at a frame number: object frame to this camera's frame."""
        return {name: self.from_scene.after(pose) for name, pose in self.scene.poses(index).items()}

    def render(
        self,
        index: float,
        poses: Mapping[str, Pose] | None = None,
        *,
        markers: bool = True,
        noise: float = 2.0,
        blur_px: float = 0.6,
        depth: bool = True,
        depth_noise_mm: float = 1.0,
    ) -> Rendered:
        """Draw one frame.

        ``poses``: object to camera frame by name (None: the path's at ``index``; objects left out aren't
        drawn); they must not intersect. ``index`` (30 to the second, fractions allowed) also decides noise and
        light. ``markers=False`` draws the same frame with nothing stuck to the objects: equal pixels wherever no
        sticker is within the blur's reach. ``noise`` is the sigma in grey values, ``blur_px`` that of the lens
        in px.
        """
        placed = dict(self.poses(index) if poses is None else poses)
        bgr, depths = self._composer.start(blur_px, depth=depth)
        self._draw_objects(bgr, depths, placed, index, blur_px, markers=markers)
        gain = self.scene.light.exposure(index)
        if gain != 1.0:
            cv2.convertScaleAbs(bgr, dst=bgr, alpha=gain)
        if noise > 0:
            self._bank("colour", noise, bgr).apply(bgr, index)
        if depths is not None and depth_noise_mm > 0:
            self._bank("depth", depth_noise_mm, depths).apply(depths, index)
        return Rendered(bgr, depths, true_objects(self.scene.boxes, self.camera, placed))

    def _draw_objects(
        self,
        bgr: Picture,
        depths: Depth | None,
        placed: dict[str, Pose],
        index: float,
        blur_px: float,
        *,
        markers: bool,
    ) -> None:
        drawings, rays = self.scene.drawings, self._composer.rays
        to_scene = self.from_scene.inverse()
        order = back_to_front(self.scene.boxes, placed)
        seen = {name: found for name in order if (found := drawings[name].see(rays, placed[name]))}

        def draw(names: frozenset[str], patch: Patch, through: PixelRays) -> None:
            for name, box in seen.items():
                if name in names:
                    drawings[name].draw(patch, through, box, to_scene, self.scene.light, index, markers=markers)

        touched = ((name, box.region) for name, box in seen.items())
        for names, region in merged(touched, 4 * reach_of(blur_px)):
            self._composer.draw(bgr, depths, region, blur_px, partial(draw, names))
        board = self.scene.board
        held = board.see(rays, placed[BOARD]) if board is not None and BOARD in placed else None
        if board is not None and held is not None:
            show = partial(board.draw, seen=held, to_scene=to_scene, light=self.scene.light, index=index)
            self._composer.draw(bgr, depths, held.region, blur_px, show)

    def _bank(self, what: str, sigma: float, pixels: Picture | Depth) -> NoiseBank:
        """The bank for this sigma; one of each kind is kept."""
        kept = self._banks.get(what)
        if kept is None or kept[0] != sigma:
            dtype = np.uint16 if what == "depth" else np.uint8
            kept = self._banks[what] = (sigma, NoiseBank(self._noise_seed, pixels.shape, sigma, dtype))
        return kept[1]
