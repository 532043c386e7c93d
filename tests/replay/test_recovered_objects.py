"""Objects whose markers were not detected: tracked, interpolated or told as missing, against the renderer's truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.config.models import PoseConfig
from common.evidence import MadeFrom
from common.geometry import Pose
from common.messages import DetectedMarker
from common.scene import Rendered, Scene
from services.detect.markers import open_detector
from services.label.history import around_of, kept
from services.label.inpaint import Crop, mask_of, regions
from services.label.labelling import Labelled, Labeller
from tests.replay.scenes import BOXES, CAMERA, FAMILY, FRAME_NS

WHOLE = Crop(0, 0, CAMERA.width, CAMERA.height)
MARKERS = {box.name: {marker.id for _, marker in box.markers()} for box in BOXES}
GAP = range(6, 9)
FRAMES = 14


@dataclass(frozen=True)
class Sequence:
    frames: list[Rendered]
    markers: list[list[DetectedMarker]]

    def without_box_1(self, index: int) -> list[DetectedMarker]:
        return [marker for marker in self.markers[index] if marker.id not in MARKERS["box-1"]]


@pytest.fixture(scope="module")
def sequence() -> Sequence:
    scene = Scene(BOXES, FAMILY, seed=4, speed=2.0)
    detector = open_detector(FAMILY, Path())
    frames = [scene.render(CAMERA, index=index, depth=False) for index in range(FRAMES)]
    return Sequence(frames, [detector.detect(cv2.cvtColor(f.bgr, cv2.COLOR_BGR2GRAY)) for f in frames])


def smeared(rendered: Rendered) -> np.ndarray:
    """Box-1's part of the picture under a motion blur of 40 px."""
    truth = next(item for item in rendered.truth if item.name == "box-1")
    window = truth.window
    left, right = max(int(window.x_min) - 30, 0), int(window.x_max) + 30
    picture = rendered.bgr.copy()
    kernel = np.full((1, 40), 1 / 40)
    picture[:, left:right] = cv2.filter2D(picture, -1, kernel)[:, left:right]
    return picture


def exact(sequence: Sequence, index: int, known_until: int, picture: np.ndarray | None = None) -> Labelled:
    """The label of frame ``index`` when the frames up to ``known_until`` have been labelled; box-1 unseen in GAP."""
    live = Labeller(BOXES, FAMILY, PoseConfig())
    for i in range(known_until + 1):
        markers = sequence.without_box_1(i) if i in GAP else sequence.markers[i]
        labelled = live.label(markers, CAMERA, "cam0", i * FRAME_NS)
        assert ([item.object for item in labelled.missing] == ["box-1"]) == (i in GAP)
    around = live.around("cam0", index * FRAME_NS)
    picture = sequence.frames[index].bgr if picture is None else picture
    worker = Labeller(BOXES, FAMILY, PoseConfig())
    return worker.label_once(sequence.without_box_1(index), CAMERA, picture, around)


def compare(labelled: Labelled, sequence: Sequence, index: int):
    label = next(item for item in labelled.objects if item.name == "box-1")
    truth = next(item for item in sequence.frames[index].truth if item.name == "box-1")
    off = np.linalg.norm(np.subtract([(c.x, c.y) for c in label.corners], truth.corners), axis=1)
    turned = np.degrees(Pose.from_label(label.pose).angle_to(Pose.from_rvec(truth.rvec, truth.tvec_mm)))
    return label, truth, off, turned


@pytest.mark.parametrize("index", GAP)
def test_markers_that_nobody_detected_are_found_where_they_must_be(sequence, index):
    labelled = exact(sequence, index, known_until=index)  # without any later frame
    label, _, off, turned = compare(labelled, sequence, index)
    assert label.pose_source == "tracked"
    assert off.max() < 1.0
    assert turned < 0.5
    assert {side.corners_kind for side in label.sides} == {"photometric"}
    sides = {side.marker for side in label.sides}
    assert not sides & {entry.marker for entry in labelled.left_out}
    assert labelled.missing == ()


@pytest.mark.parametrize("index", GAP)
def test_a_smeared_object_is_interpolated_and_its_markers_are_erased(sequence, index):
    labelled = exact(sequence, index, known_until=GAP.stop, picture=smeared(sequence.frames[index]))
    label, truth, off, turned = compare(labelled, sequence, index)
    assert label.pose_source == "interpolated"
    assert label.sides == ()
    assert label.quality.markers == 0
    bar = label.quality.uncertainty
    assert (off < 3 * np.array(bar.corners_px)).all()
    assert turned < 3 * bar.rotation_deg
    assert abs(label.distance_mm - truth.distance_mm) < 3 * bar.distance_mm
    assert labelled.missing == ()
    mask = mask_of(regions(labelled.objects, labelled.left_out, BOXES, CAMERA), WHOLE) > 0
    for marker in (item for item in truth.markers if item.visible):
        black = np.zeros(mask.shape, np.uint8)
        cv2.fillPoly(black, [np.round(np.array(marker.corners) * 16).astype(np.int32)], 255, cv2.LINE_8, 4)
        assert not ((black > 0) & ~mask).any()


def test_without_a_later_frame_a_smeared_object_is_missing(sequence):
    index = GAP.start
    labelled = exact(sequence, index, known_until=index, picture=smeared(sequence.frames[index]))
    assert [item.name for item in labelled.objects] == ["box-2"]
    (missing,) = labelled.missing
    assert (missing.object, missing.reason) == ("box-1", "not_detected")
    assert missing.seen_ms_ago == pytest.approx(33.3, abs=0.1)


def test_after_a_second_nothing_is_expected_any_more(sequence):
    live = Labeller(BOXES, FAMILY, PoseConfig())
    live.label(sequence.markers[0], CAMERA, "cam0", 0)
    assert len(live.label(sequence.without_box_1(1), CAMERA, "cam0", 900_000_000).missing) == 1
    assert live.label(sequence.without_box_1(1), CAMERA, "cam0", 1_100_000_000).missing == ()


def test_an_object_that_left_the_picture_is_not_missing(sequence):
    live = Labeller(BOXES, FAMILY, PoseConfig())
    shift = np.array([0.0, 0.0])
    for i in range(12):  # box-1 slides out to the left, at 60 px a frame
        shift = np.array([-60.0 * i, 0.0])
        moved = [
            DetectedMarker(id=m.id, corners=tuple(map(tuple, np.add(m.corners, shift))), kind=m.kind)
            for m in sequence.markers[0]
            if m.id in MARKERS["box-1"]
        ]
        inside = [m for m in moved if min(x for x, _ in m.corners) > 0]
        labelled = live.label(inside, CAMERA, "cam0", i * FRAME_NS)
        if i == 0:
            assert len(labelled.objects) == 1
    later = live.label([], CAMERA, "cam0", 20 * FRAME_NS)
    assert "box-1" not in [item.object for item in later.missing]


def test_time_that_runs_backwards_begins_another_stream(sequence):
    live = Labeller(BOXES, FAMILY, PoseConfig())
    live.label(sequence.markers[0], CAMERA, "cam0", 5 * FRAME_NS)
    assert live.label(sequence.without_box_1(0), CAMERA, "cam0", 0).missing == ()
    assert live.around("cam0", FRAME_NS).expected[0].name == "box-2"


def test_a_label_can_be_made_again_from_what_it_keeps(sequence):
    """Tracked and interpolated objects too: what other frames said goes through JSON and is the same bits."""
    index = GAP[0] + 1
    for known_until, picture in ((index, sequence.frames[index].bgr), (FRAMES - 1, smeared(sequence.frames[index]))):
        live = Labeller(BOXES, FAMILY, PoseConfig())
        for i in range(known_until + 1):
            live.label(sequence.without_box_1(i) if i in GAP else sequence.markers[i], CAMERA, "cam0", i * FRAME_NS)
        around = live.around("cam0", index * FRAME_NS)
        text = kept(sequence.without_box_1(index), around).model_dump_json()
        made_from = MadeFrom.model_validate_json(text)
        worker = Labeller(BOXES, FAMILY, PoseConfig())
        first = worker.label_once(sequence.without_box_1(index), CAMERA, picture, around)
        again = worker.label_once(made_from.markers, CAMERA, picture, around_of(made_from))
        assert again == first
        assert next(item for item in again.objects if item.name == "box-1").pose_source != "measured"
