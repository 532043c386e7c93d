"""Pictures with markers and the same pictures without them: what erasing is judged by."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import Box, BoxSide, CameraModel, MarkerOnSide, Pose
from common.markers import family
from common.messages import TrueMarker, TrueObject
from common.scene import Scene, SceneCamera
from common.scene.hand import Hand, noisy_depth
from services.detect.markers import MarkerDetector, open_detector
from services.label.covering import Covering, covering
from services.label.labelling import Labeller
from services.label.occlusion import DepthPicture
from services.label.regions import regions_on_sides
from services.label.surfaces import Region
from tools.evaluate.chain import KEEP

Picture = NDArray[np.uint8]
Kind = Literal["plain", "covered", "blurred", "outside"]

FAMILY = family("apriltag_36h11", Path())
CAMERA = CameraModel(
    1280,
    720,
    np.array([[921.6, 0, 639.5], [0, 921.6, 359.5], [0, 0, 1.0]]),
    np.array([0.08, -0.15, 0.0005, -0.0005, 0.05]),
)
KINDS: tuple[Kind, ...] = ("plain", "covered", "plain", "blurred", "plain", "outside")
DISTANCE_MM = 750.0
DEPTH_NOISE = 0.01
_STEP = 41
_SCENES = 4
"""Scenes (rooms, cartons, paths), among which the frames are shared out."""
_BEFORE_MM = 100.0
_BLUR_SHARE = 0.2
"""Length of the motion blur as a share of the marker's side: over one and a half cells, well unreadable."""


@dataclass(frozen=True, eq=False)
class Case:
    """A frame as the camera takes it, its twin without markers, and what tagmill would erase in it.

    ``marker`` (H, W): pixels that show a marker, paper and softened edge included (not those that a marker's motion
    blur reaches beyond it). ``missed``: objects that show a marker and got no sure pose: such a frame is refused
    (``incomplete``, ``ambiguous_pose``) unless the rig says otherwise. ``unseen``: visible markers not detected.
    """

    kind: Kind
    bgr: Picture
    bare: Picture
    marker: NDArray[np.bool_]
    regions: tuple[Region, ...]
    covered: Covering | None
    missed: tuple[str, ...]
    unseen: int


@dataclass(frozen=True, eq=False)
class _Chain:
    """Detector and labeller as the services use them."""

    boxes: tuple[Box, ...]
    detector: MarkerDetector
    labeller: Labeller


def boxes() -> tuple[Box, ...]:
    """Two cartons with a marker on each side but the bottom: beside lettering and a logo, over tape, near edges."""
    return _box("box-1", "carton", 0), _box("box-2", "crate", 10)


def _box(name: str, type_: str, first: int) -> Box:
    def side(face: Literal["front", "back", "left", "right", "top"], number: int, right: float, up: float) -> BoxSide:
        return BoxSide(face, face, (MarkerOnSide(first + number, 50, 10, (right, up, 0.0)),))

    sides = (
        side("front", 0, -60, 40),
        side("back", 1, 70, -30),
        side("left", 2, 40, 30),
        side("right", 3, 0, 0),
        side("top", 4, -20, 0),
    )
    return Box(name, type_, (260.0, 200.0, 160.0), sides)


def cases(seed: int, frames: int) -> Iterator[Case]:
    """Seeded frames: plain ones, one marker covered by a hand, one blurred, and objects half outside the picture."""
    configured = boxes()
    chain = _Chain(configured, open_detector(FAMILY, Path()), Labeller(configured, FAMILY, KEEP))
    share = -(-frames // _SCENES)
    for number in range(frames):
        if number % share == 0:
            scene = SceneCamera(
                Scene(configured, FAMILY, seed * _SCENES + number // share, distance_mm=DISTANCE_MM), CAMERA
            )
        kind = KINDS[number % len(KINDS)]
        yield _case(kind, scene, number * _STEP + seed, chain)


def _case(kind: Kind, scene: SceneCamera, index: int, chain: _Chain) -> Case:
    configured, poses = chain.boxes, scene.poses(index)
    if kind == "outside":
        poses = {name: Pose(pose.rotation, pose.translation + _aside(pose)) for name, pose in poses.items()}
    with_markers = scene.render(index, poses)
    without = scene.render(index, poses, markers=False)
    bgr, bare, depth = with_markers.bgr, without.bgr, with_markers.depth
    sticker = (bgr != bare).any(axis=2)
    chosen = _one_of_two(with_markers.truth) if kind in ("covered", "blurred") else None
    if chosen is not None and kind == "covered":
        hand = _hand_before(chosen, configured, poses)
        hand.draw(bgr, depth, CAMERA)
        hand.draw(bare, None, CAMERA)
    elif chosen is not None:
        _smear(bgr, chosen)
        _smear(bare, chosen)
    assert depth is not None
    picture = DepthPicture(noisy_depth(depth, DEPTH_NOISE, np.random.default_rng(index)), 1.0)
    seen = chain.detector.detect(np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), dtype=np.uint8))
    labelled = chain.labeller.label_once(seen, CAMERA, bgr, depth=picture)
    found = regions_on_sides(labelled.objects, labelled.left_out, configured, CAMERA)
    shows = {item.name for item in with_markers.truth if any(_in_view(marker) for marker in item.markers)}
    visible = sum(marker.visible for item in with_markers.truth for marker in item.markers)
    posed = {item.name for item in labelled.objects if not item.quality.ambiguous}
    missed = tuple(sorted(shows - posed))
    marker = sticker & (bgr != bare).any(axis=2)
    return Case(kind, bgr, bare, marker, found, covering(found, picture), missed, visible - len(seen))


def _aside(pose: Pose) -> NDArray[np.float64]:
    """A way out of the picture, so far that its edge cuts the object."""
    x = float(pose.translation[0])
    edge = 0.694 * float(pose.translation[2])
    return np.array([np.copysign(edge - 20.0, x) - x, 0.0, 0.0])


def _in_view(marker: TrueMarker) -> bool:
    """Whether the picture holds a part of a marker's front (which runs clockwise)."""
    quad = np.array(marker.corners, dtype=np.float32)
    return bool(CAMERA.contains(quad).any()) and cv2.contourArea(quad, oriented=True) > 1.0


def _shown(item: TrueObject) -> list[TrueMarker]:
    return [marker for marker in item.markers if marker.visible]


def _one_of_two(truth: tuple[TrueObject, ...]) -> TrueMarker | None:
    """The largest marker of the first object that shows at least two."""
    for item in truth:
        shown = _shown(item)
        if len(shown) > 1:
            return max(shown, key=_side_px)
    return None


def _side_px(marker: TrueMarker) -> float:
    return float(np.sqrt(abs(cv2.contourArea(np.array(marker.corners, dtype=np.float32)))))


def _hand_before(marker: TrueMarker, configured: tuple[Box, ...], poses: dict[str, Pose]) -> Hand:
    """A hand whose fingers lie before a marker, nearer than it by 100 mm."""
    for box in configured:
        for side, mine in box.markers():
            if mine.id == marker.id:
                centre = poses[box.name].apply(box.marker_pose(side, mine).translation)[0]
    at = centre * (1 - _BEFORE_MM / float(np.linalg.norm(centre))) + np.array([25.0, 75.0, 0.0])
    return Hand(Pose(np.diag([1.0, -1.0, -1.0]), at))


def _smear(bgr: Picture, marker: TrueMarker) -> None:
    """Motion blur of a marker's neighbourhood, in place."""
    length = max(round(_BLUR_SHARE * _side_px(marker)) | 1, 3)
    corners = np.array(marker.corners)
    pad = 0.6 * _side_px(marker)
    low = np.maximum(np.floor(corners.min(axis=0) - pad).astype(int), 0)
    high = np.ceil(corners.max(axis=0) + pad).astype(int)
    part = bgr[low[1] : high[1], low[0] : high[0]]
    part[...] = cv2.blur(part, (length, 1))
