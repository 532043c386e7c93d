from __future__ import annotations

import cv2
import numpy as np
import pytest

from common.labels import ErasedPolygon
from services.label.inpaint import Crop, crops, erase, mask_of

random = np.random.default_rng(1)
PICTURE = cv2.GaussianBlur(random.integers(0, 255, (360, 640, 3), dtype=np.uint8), (0, 0), 1.5)


def polygon(*corners: tuple[float, float]) -> ErasedPolygon:
    return ErasedPolygon(marker=0, because="detected", polygon=corners)


def square(x: float, y: float, size: float) -> ErasedPolygon:
    return polygon((x, y), (x + size, y + 3), (x + size - 5, y + size), (x - 4, y + size - 2))


SCENES = {
    "one": [square(300.3, 150.7, 60)],
    "apart": [square(50, 50, 40), square(400.5, 200.2, 70), square(560, 20, 30)],
    "near each other": [square(100, 100, 40), square(148, 105, 40), square(160, 150, 30)],
    "overlapping": [square(100, 100, 60), square(130, 120, 60)],
    "at the edges": [
        polygon((-1, -1), (30, -1), (30, 25), (-1, 25)),
        polygon((610, 300), (640, 300), (640, 360), (600, 360)),
    ],
    "a few pixels apart": [square(200, 100, 30), square(200, 144, 30), square(245, 100, 30)],
}


@pytest.mark.parametrize("method", ["telea", "ns"])
@pytest.mark.parametrize("radius", [1.0, 3.0, 5.5])
@pytest.mark.parametrize("scene", SCENES)
def test_the_same_pixels_as_a_fill_of_the_whole_picture(scene, radius, method):
    flag = {"telea": cv2.INPAINT_TELEA, "ns": cv2.INPAINT_NS}[method]
    mask = mask_of(SCENES[scene], Crop(0, 0, 640, 360))
    whole = cv2.inpaint(PICTURE, mask, radius, flag)
    ours = PICTURE.copy()
    erase(ours, SCENES[scene], method, radius)
    np.testing.assert_array_equal(ours, whole)


@pytest.mark.parametrize("scene", SCENES)
def test_what_lies_outside_is_not_touched(scene):
    ours = PICTURE.copy()
    erase(ours, SCENES[scene])
    mask = mask_of(SCENES[scene], Crop(0, 0, 640, 360)) > 0
    np.testing.assert_array_equal(ours[~mask], PICTURE[~mask])
    assert (ours[mask] != PICTURE[mask]).any()


def test_works_in_a_view_of_shared_memory():
    memory = bytearray(PICTURE.tobytes())
    view = np.frombuffer(memory, np.uint8).reshape(PICTURE.shape)
    erase(view, SCENES["one"])
    expected = PICTURE.copy()
    erase(expected, SCENES["one"])
    assert bytes(memory) == expected.tobytes()


def test_nothing_to_erase_changes_nothing():
    ours = PICTURE.copy()
    erase(ours, [])
    erase(ours, [square(-500, -500, 50), square(2000, 100, 50)])
    np.testing.assert_array_equal(ours, PICTURE)


def test_an_unknown_method_is_named():
    with pytest.raises(ValueError, match="'magic'; known are plane, smooth, telea, ns"):
        erase(PICTURE.copy(), [], "magic")


def test_the_mask_holds_every_pixel_that_a_polygon_touches():
    mask = mask_of([polygon((10, 10), (20, 10), (20, 20), (10, 20))], Crop(0, 0, 40, 40)) > 0
    assert mask.sum() == 11 * 11
    assert mask[10:21, 10:21].all()
    shifted = mask_of([polygon((10.4, 10.4), (20.4, 10.4), (20.4, 20.4), (10.4, 20.4))], Crop(5, 5, 40, 40)) > 0
    assert shifted[6:16, 6:16].all()


def test_crops_are_disjoint_and_hold_everything():
    found = crops([*SCENES["apart"], *SCENES["near each other"], *SCENES["at the edges"]], 640, 360, 3.0)
    for i, crop in enumerate(found):
        assert 0 <= crop.left < crop.right <= 640
        assert 0 <= crop.top < crop.bottom <= 360
        assert not any(crop.overlaps(other) for other in found[i + 1 :])
    covered = np.zeros((360, 640), bool)
    for crop in found:
        covered[crop.top : crop.bottom, crop.left : crop.right] = True
    for scene in ("apart", "near each other", "at the edges"):
        assert covered[mask_of(SCENES[scene], Crop(0, 0, 640, 360)) > 0].all()
