"""The rig file: its fields, its loader, its mistakes in plain words, calibration files."""

from common.config.calibration import read_calibration, write_calibration
from common.config.differences import differences
from common.config.extrinsics import Extrinsics, read_extrinsics, write_extrinsics
from common.config.models import CameraConfig, RigConfig
from common.config.rig import Rig, load_rig
from common.config.surroundings import known_drivers

__all__ = [
    "CameraConfig",
    "Extrinsics",
    "Rig",
    "RigConfig",
    "differences",
    "known_drivers",
    "load_rig",
    "read_calibration",
    "read_extrinsics",
    "write_calibration",
    "write_extrinsics",
]
