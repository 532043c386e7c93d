"""The RealSense SDK: its import, its devices, its errors in plain words. Only ``realsense*`` modules import it."""

from __future__ import annotations

from typing import Any

from common.errors import CameraError, ConfigError
from services.capture.usb import RULE, plugged

try:
    import pyrealsense2 as rs
except ImportError as error:
    if "libusb" in str(error):
        raise ConfigError(
            f"pyrealsense2 is installed but can't be loaded ({error}): apt install libusb-1.0-0"
        ) from error
    raise

__all__ = ["camera_error", "find_device", "info_of", "on_usb_2", "rs", "title_of"]

UDEV_CURE = f"copy {RULE} to /etc/udev/rules.d, run `sudo udevadm control --reload` and plug it in again"
_ACCESS = ("permission", "access", "rs2_usb_status_access")
_BUSY = ("busy", "already opened", "already in use", "rs2_usb_status_busy")


def info_of(device: Any, key: Any) -> str:
    """One of the device's texts, empty if it doesn't have it."""
    return str(device.get_info(key)) if device.supports(key) else ""


def title_of(device: Any) -> str:
    """The device as a sentence names it: ``Intel RealSense D435 (serial 012345678901)``."""
    name = info_of(device, rs.camera_info.name) or "RealSense camera"
    serial = info_of(device, rs.camera_info.serial_number)
    return f"{name} (serial {serial})" if serial else name


def on_usb_2(device: Any) -> bool:
    """Whether it is plugged in where it offers few modes."""
    return info_of(device, rs.camera_info.usb_type_descriptor).startswith(("1", "2"))


def find_device(context: Any, serial: str | None) -> Any:
    """The attached device of that serial number, or the first one. CameraError at once if it isn't there.

    The SDK itself would wait 15 s for it, with Python's interpreter lock held.
    """
    try:
        devices = list(context.query_devices())
    except RuntimeError as error:
        raise camera_error("the RealSense cameras can't be listed", error) from error
    serials = [info_of(device, rs.camera_info.serial_number) for device in devices]
    if serial is None and devices:
        return devices[0]
    if serial in serials:
        return devices[serials.index(serial)]
    wanted = "no RealSense camera is attached" if serial is None else f"no RealSense camera {serial} is attached"
    others = f" (attached: {', '.join(sorted(serials))})" if serials else ""
    seen = next((one.hint for one in plugged("realsense") if one.hint and not devices), "")
    raise CameraError(f"{wanted}{others}; {seen or 'check its cable and power, and that it is on a USB 3 port'}")


def camera_error(what: str, error: RuntimeError) -> CameraError:
    """The SDK's RuntimeError as ours; it tells its kinds apart by their text alone."""
    text = " ".join(str(error).split())
    if any(word in text.lower() for word in _ACCESS):
        return CameraError(f"{what}: no permission ({text}); {UDEV_CURE}")
    if any(word in text.lower() for word in _BUSY):
        return CameraError(f"{what}: another program uses it ({text}); close that one")
    return CameraError(f"{what}: {text}")
