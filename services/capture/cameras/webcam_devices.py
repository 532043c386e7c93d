"""Which webcams are attached, and the one that a rig file means."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from common.config.models import WebcamOptions
from common.errors import CameraError
from services.capture.cameras.base import Attached
from services.capture.cameras.webcam_v4l2 import Capability, open_device, refusal


@dataclass(frozen=True, slots=True)
class Places:
    """Where Linux shows its video devices."""

    devices: Path = Path("/dev")
    names: Path = Path("/dev/v4l/by-id")
    classes: Path = Path("/sys/class/video4linux")


MACHINE = Places()


def find(options: WebcamOptions, places: Places = MACHINE) -> Path:
    """The device node that is meant, found anew each time: its number may change when it is plugged in again.

    Its ``path`` is the caller's affair. Without index and serial the first camera. Raises CameraError if it isn't
    there, naming those that are.
    """
    if options.index is not None:
        return places.devices / f"video{options.index}"
    if options.serial is None:
        node = next((node for node in _nodes(places) if _may_capture(node)), None)
        if node is None:
            raise CameraError("no webcam is attached: there is no capture device among /dev/video*; check its cable")
        return node
    return _by_serial(options.serial, places)


def name_of(node: Path, places: Places = MACHINE) -> str:
    """The name below /dev/v4l/by-id, which holds the maker's serial number; empty if there is none."""
    real = node.resolve()
    for link in _links(places):
        if link.resolve() == real:
            return link.name
    return ""


def attached(places: Places = MACHINE) -> list[Attached]:
    """All webcams; see ``Attached``. A node without permission is listed with what to do."""
    found = []
    for node in _nodes(places):
        try:
            with open_device(node) as device:
                about = device.capability()
                if about.captures:
                    modes = tuple(str(mode) for mode in device.modes())
                    found.append(Attached("webcam", about.card, name_of(node, places), str(node), modes, _busy(node)))
        except CameraError as error:
            name = _read(places.classes / node.name / "name") or node.name
            if _read(places.classes / node.name / "index") in ("", "0"):
                found.append(Attached("webcam", name, name_of(node, places), str(node), (), error.message))
        except OSError:
            continue  # a node that doesn't answer as a video device is no webcam
    return found


def _busy(node: Path) -> str:
    try:
        with open_device(node) as device:
            device.refuse_if_busy()
    except OSError as error:
        return refusal(node, error)
    return ""


def _by_serial(wanted: str, places: Places) -> Path:
    links = list(_links(places))
    fitting = [link for link in links if link.name == wanted] or [link for link in links if wanted in link.name]
    nodes = sorted({link.resolve() for link in fitting if _may_capture(link.resolve())})
    if len(nodes) == 1:
        return nodes[0]
    known = ", ".join(link.name for link in links) or "none"
    if nodes:
        names = ", ".join(link.name for link in fitting)
        raise CameraError(f"'{wanted}' fits several webcams ({names}); write more of the name")
    raise CameraError(f"webcam '{wanted}' is not attached; {places.names} has {known}")


def _nodes(places: Places) -> Iterator[Path]:
    found = ((re.fullmatch(r"video(\d+)", path.name), path) for path in places.devices.glob("video*"))
    numbered = [(int(match[1]), path) for match, path in found if match]
    return (path for _, path in sorted(numbered))


def _links(places: Places) -> Iterator[Path]:
    return iter(sorted(places.names.iterdir()) if places.names.is_dir() else ())


def _may_capture(node: Path) -> bool:
    """False for a camera's second node, which gives metadata; one that can't be asked may."""
    try:
        with open_device(node) as device:
            return device.capability().captures
    except CameraError:
        return True
    except OSError:
        return False


def capability(node: Path) -> Capability:
    """What a node is; raises CameraError if it is in use, can't be opened, or is no camera."""
    with open_device(node) as device:
        try:
            about = device.capability()
            if about.captures:
                device.refuse_if_busy()
        except OSError as error:
            raise CameraError(refusal(node, error)) from error
    if not about.captures:
        raise CameraError(f"{node} gives no pictures ({about.card}'s other node); name its neighbour, e.g. video0")
    return about


def _read(path: Path) -> str:
    return path.read_text().strip() if path.is_file() else ""
