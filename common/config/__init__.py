"""The rig file: its fields, its loader, its mistakes in plain words, calibration files."""

from common.config.calibration import read_calibration, write_calibration
from common.config.differences import differences
from common.config.models import CameraConfig, RigConfig
from common.config.rig import Rig, load_rig
from common.config.surroundings import known_drivers

__all__ = [
    "CameraConfig",
    "Rig",
    "RigConfig",
    "differences",
    "known_drivers",
    "load_rig",
    "read_calibration",
    "write_calibration",
]
