from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from common.geometry import Box, Pose, hidden

CUBE = Box("near", "box", (100.0, 100.0, 100.0), ())
# X right, Z up is y down, Y away is z: the cube stands upright, its front faces the camera at 450 mm
AT = Pose(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([0.0, 0.0, 500.0]))


def test_a_box_in_front_hides_what_lies_behind_it():
    points = np.array([[0, 0, 1000], [200, 0, 1000], [0, 0, 400], [0, 0, 450.01], [99, 0, 1000.0], [0, -112, 1000]])
    # seen from the camera its front covers x/z and y/z up to 50/450, which is 111 mm at 1000
    assert hidden(points, [(CUBE, AT)]).tolist() == [True, False, False, False, True, False]
    assert hidden(points, []).tolist() == [False] * 6


def test_inside_and_behind_the_camera():
    points = np.array([[0, 0, 500], [0, 0, -1000.0]])
    assert hidden(points, [(CUBE, AT)]).tolist() == [True, False]


@given(x=st.floats(-49, 49), y=st.floats(-49, 49))
def test_its_front_does_not_hide_itself_but_its_back(x, y):
    front, back = np.array([[x, y, 450]]), np.array([[x, y, 550]])
    assert not hidden(front, [(CUBE, AT)])[0]
    assert hidden(back, [(CUBE, AT)])[0]
