"""A RealSense's settings: what the rig file gives is set, everything else is automatic, whatever the Viewer left."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from common.bounded import parse_json, read_bytes
from common.config.realsense import RealSenseOptions
from common.errors import ConfigError
from services.capture.cameras.realsense_sdk import camera_error, info_of, rs, title_of

_MOST_BYTES_OF_A_PRESET = 1 << 20
SYNC_MODES = {"off": 0, "master": 1, "slave": 2, "full_slave": 3}
"""``rs.option.inter_cam_sync_mode`` of the D400 family."""


def apply_settings(
    device: Any, colour: Any, depth: Any | None, options: RealSenseOptions, preset_file: Path | None
) -> None:
    """Set everything before the sensors stream. ``preset_file`` is absolute.

    Raises ConfigError for what this camera doesn't have or allow, CameraError if it is lost meanwhile.
    """
    try:
        if preset_file is not None:
            _load_json(device, preset_file)
        for sensor in device.query_sensors():
            _set_if_there(sensor, rs.option.global_time_enabled, 1)
        _set_colour(colour, options)
        if depth is not None:
            _set_depth(depth, colour, options)
    except RuntimeError as error:
        raise camera_error(f"the {title_of(device)} refuses a setting", error) from error


def _set_colour(sensor: Any, options: RealSenseOptions) -> None:
    _set_exposure(sensor, options.exposure, options.gain, "exposure", "gain")
    if options.white_balance is None:
        _set_if_there(sensor, rs.option.enable_auto_white_balance, 1)
    else:
        _set_if_there(sensor, rs.option.enable_auto_white_balance, 0)
        _set(sensor, rs.option.white_balance, options.white_balance, "white_balance")


def _set_depth(sensor: Any, colour: Any, options: RealSenseOptions) -> None:
    if options.preset is not None:
        _set(sensor, rs.option.visual_preset, _preset(sensor, options.preset), "preset")
    one_for_both = info_of(sensor, rs.camera_info.name) == info_of(colour, rs.camera_info.name)
    if one_for_both and options.depth_exposure is not None:
        raise ConfigError("depth_exposure: this camera takes colour and depth with one sensor; give `exposure` only")
    if not one_for_both and (options.preset_file is None or options.depth_exposure is not None):
        _set_exposure(sensor, options.depth_exposure, options.depth_gain, "depth_exposure", "depth_gain")
    if options.emitter is not None:
        _set(sensor, rs.option.emitter_enabled, float(options.emitter), "emitter")
    if options.laser_power is not None:
        _set(sensor, rs.option.laser_power, options.laser_power, "laser_power")
    if options.sync != "off" or sensor.supports(rs.option.inter_cam_sync_mode):
        _set(sensor, rs.option.inter_cam_sync_mode, SYNC_MODES[options.sync], "sync")


def _set_exposure(sensor: Any, exposure: float | None, gain: float | None, key: str, gain_key: str) -> None:
    if exposure is None:
        _set_if_there(sensor, rs.option.enable_auto_exposure, 1)
        return
    _set_if_there(sensor, rs.option.enable_auto_exposure, 0)
    _set(sensor, rs.option.exposure, exposure, key)
    if gain is not None:
        _set(sensor, rs.option.gain, gain, gain_key)


def _set(sensor: Any, option: Any, value: float, key: str) -> None:
    name = info_of(sensor, rs.camera_info.name) or "sensor"
    if not sensor.supports(option) or sensor.is_option_read_only(option):
        raise ConfigError(f"{key}: this camera's {name} can't set {option.name}; leave it out")
    allowed = sensor.get_option_range(option)
    if not allowed.min <= value <= allowed.max:
        raise ConfigError(
            f"{key}: {value:g} is not allowed; this camera's {name} takes {allowed.min:g} to {allowed.max:g} "
            f"in steps of {allowed.step:g}"
        )
    sensor.set_option(option, value)


def _set_if_there(sensor: Any, option: Any, value: float) -> None:
    if sensor.supports(option) and not sensor.is_option_read_only(option) and sensor.get_option(option) != value:
        sensor.set_option(option, value)


def _preset(sensor: Any, wanted: str) -> float:
    """The number of a visual preset; its name in any case, with spaces, ``-`` or ``_``."""
    if not sensor.supports(rs.option.visual_preset):
        raise ConfigError("preset: this camera has no visual presets; leave it out")
    allowed = sensor.get_option_range(rs.option.visual_preset)
    family = {int(member): name for name, member in rs.rs400_visual_preset.__members__.items()}
    names: dict[str, int] = {}
    for number in range(int(allowed.min), int(allowed.max) + 1):
        text = sensor.get_option_value_description(rs.option.visual_preset, number) or family.get(number, "")
        if text:
            names.setdefault(_plain(text), number)
    if _plain(wanted) not in names:
        raise ConfigError(f"preset: this camera has no '{wanted}'; it has {', '.join(names)}")
    return float(names[_plain(wanted)])


def _plain(name: str) -> str:
    return "_".join(name.lower().replace("-", " ").replace("_", " ").split())


def _load_json(device: Any, path: Path) -> None:
    """A file that the RealSense Viewer saved."""
    try:
        text = read_bytes(path, _MOST_BYTES_OF_A_PRESET).decode()
        parse_json(text)
    except (OSError, ValueError) as error:
        raise ConfigError(f"preset_file: {path} can't be read as JSON: {error}") from error
    advanced = info_of(device, rs.camera_info.advanced_mode)
    if advanced.upper() != "YES":
        why = "has its advanced mode off; turn it on in the RealSense Viewer once" if advanced else "takes no such file"
        raise ConfigError(f"preset_file: the {title_of(device)} {why}")
    rs.serializable_device(device).load_json(text)
