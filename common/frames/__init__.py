"""Frames in shared memory: the ring of a camera, the ring of ordered samples. The only package that maps memory."""

from common.frames.layout import Layout, Pictures
from common.frames.reader import FrameReader, FrameView
from common.frames.samples import SampleRing, SampleSlots
from common.frames.segment import dead_segments, segment_name, shm_folder, shm_room, sweep
from common.frames.writer import FrameWriter

__all__ = [
    "FrameReader",
    "FrameView",
    "FrameWriter",
    "Layout",
    "Pictures",
    "SampleRing",
    "SampleSlots",
    "dead_segments",
    "segment_name",
    "shm_folder",
    "shm_room",
    "sweep",
]
