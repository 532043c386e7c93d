"""A webcam's settings: locked as the rig file says, and told about where an automatism is left on."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from dataclasses import dataclass

from common.config.models import WebcamOptions
from common.errors import ConfigError
from services.capture.cameras.webcam_v4l2 import Control, Device

_EXPOSURE_AUTO, _EXPOSURE, _EXPOSURE_PRIORITY = 0x009A0901, 0x009A0902, 0x009A0903
_FOCUS, _FOCUS_AUTO = 0x009A090A, 0x009A090C
_BALANCE_AUTO, _BALANCE = 0x0098090C, 0x0098091A
_GAIN_AUTO, _GAIN = 0x00980912, 0x00980913
_MANUAL_EXPOSURE = 1
_AUTOMATIC_EXPOSURES = (0, 3)
"""Fully automatic and aperture priority; manual (1) and shutter priority (2) keep the exposure time."""
_EXPOSURE_STEPS_PER_MS = 10
"""V4L2 counts exposure in 100 us."""


@dataclass(frozen=True, slots=True)
class Lock:
    """A setting that must stay: what it is called in the rig file, the control and its value."""

    key: str
    control: int
    value: int


def locks_of(device: Device, options: WebcamOptions, where: str) -> tuple[Lock, ...]:
    """What must be set, in that order: an automatism first, since it owns its value.

    Raises ConfigError for a setting that this camera doesn't have, or a value out of its range.
    """
    controls = device.controls()
    by_id = {control.id: control for control in controls.values()}
    found: list[Lock] = []
    for key, value, number, automatisms in _wanted(options):
        control = by_id.get(number)
        if control is None:
            have = ", ".join(sorted(controls)) or "no settings at all"
            raise ConfigError(f"{where}.{key}: this camera can't be set so; it has {have}")
        found += [Lock(key, other, off) for other, off in automatisms if other in by_id]
        found.append(_lock(where, key, control, value))
    for name, value in options.controls.items():
        if name not in controls:
            near = difflib.get_close_matches(name, controls, 1)
            hint = f"; did you mean '{near[0]}'?" if near else f"; it has {', '.join(sorted(controls)) or 'none'}"
            raise ConfigError(f"{where}.controls.{name}: this camera has no such setting{hint}")
        found.append(_lock(where, f"controls.{name}", controls[name], value))
    return tuple(found)


def apply(device: Device, locks: tuple[Lock, ...]) -> tuple[str, ...]:
    """Set what is not as it must be; returns a warning for each setting that the camera doesn't take.

    Called again once the stream runs: some cameras fall back to their defaults when it starts.
    """
    warnings: list[str] = []
    for lock in locks:
        try:
            if device.value(lock.control) != lock.value:
                device.set(lock.control, lock.value)
            present: object = device.value(lock.control)
        except OSError as error:
            present = error.strerror
        if present != lock.value:
            warnings.append(f"{lock.key}: the camera answers {present}, not {lock.value}")
    return tuple(dict.fromkeys(warnings))


def left_on(device: Device, name: str) -> tuple[str, ...]:
    """A warning for each automatism that spoils a calibration or the pictures."""
    warnings: list[str] = []
    by_id = {control.id for control in device.controls().values()}
    if _FOCUS_AUTO in by_id and _value(device, _FOCUS_AUTO):
        warnings.append(
            f"camera {name} focuses by itself: each change of focus changes the focal length, so no calibration holds; "
            "lock it with `focus`"
        )
    if _EXPOSURE_AUTO in by_id and _value(device, _EXPOSURE_AUTO) in _AUTOMATIC_EXPOSURES:
        warnings.append(
            f"camera {name} exposes by itself: brightness and motion blur change while it records; "
            "lock it with `exposure_ms`"
        )
    return tuple(warnings)


def _wanted(options: WebcamOptions) -> Iterator[tuple[str, int, int, tuple[tuple[int, int], ...]]]:
    """Key, value, control, and the automatisms that have to be off for it."""
    if options.exposure_ms is not None:
        steps = max(1, round(options.exposure_ms * _EXPOSURE_STEPS_PER_MS))
        # The second keeps the frame rate where the first would lengthen the exposure in the dark.
        yield "exposure_ms", steps, _EXPOSURE, ((_EXPOSURE_AUTO, _MANUAL_EXPOSURE), (_EXPOSURE_PRIORITY, 0))
    if options.gain is not None:
        yield "gain", options.gain, _GAIN, ((_GAIN_AUTO, 0),)
    if options.white_balance_k is not None:
        yield "white_balance_k", options.white_balance_k, _BALANCE, ((_BALANCE_AUTO, 0),)
    if options.focus is not None:
        yield "focus", options.focus, _FOCUS, ((_FOCUS_AUTO, 0),)


def _lock(where: str, key: str, control: Control, value: int) -> Lock:
    if control.minimum <= value <= control.maximum:
        return Lock(key, control.id, value)
    scale = _EXPOSURE_STEPS_PER_MS if key == "exposure_ms" else 1
    low, high, step = (number / scale for number in (control.minimum, control.maximum, control.step))
    raise ConfigError(
        f"{where}.{key}: {value / scale:g} is not possible with this camera; {low:g} to {high:g} in steps of {step:g}"
    )


def _value(device: Device, control: int) -> int | None:
    try:
        return device.value(control)
    except OSError:
        return None
