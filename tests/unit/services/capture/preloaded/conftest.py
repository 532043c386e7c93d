"""Tests that need a process of their own, in which files are webcams: ../test_webcam.py runs them there."""

from __future__ import annotations

from tests.support.v4l2.device import is_preloaded

collect_ignore_glob = [] if is_preloaded() else ["test_*.py"]
