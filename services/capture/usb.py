"""Depth cameras on the USB, seen without any SDK: so that a missing library or permission can be told."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

SYSFS = Path("/sys/bus/usb/devices")
NODES = Path("/dev/bus/usb")
RULE = "deploy/udev/70-tagmill-cameras.rules"


@dataclass(frozen=True, slots=True)
class Kind:
    """How a driver's cameras announce themselves: vendor, products (empty: any) and a word of the product's name."""

    driver: str
    what: str
    vendor: str
    products: tuple[str, ...] = ()
    word: str = ""


KINDS = (
    Kind("realsense", "Intel RealSense", "8086", word="RealSense"),
    Kind("kinect2", "Kinect v2", "045e", ("02c4", "02d8", "02d9")),
    Kind("oak", "Luxonis OAK", "03e7"),
)


@dataclass(frozen=True, slots=True)
class Plugged:
    """A camera that is plugged in. ``allowed``: whether this user may open it. ``mbit_s``: of its USB link."""

    kind: Kind
    name: str
    address: str
    allowed: bool
    mbit_s: float

    @property
    def hint(self) -> str:
        """What keeps it from being used, with the cure; empty if nothing is seen from here."""
        if not self.allowed:
            return (
                f"{self.name} is plugged in, but this user may not open it: sudo cp {RULE} /etc/udev/rules.d/ && "
                "sudo udevadm control --reload && sudo udevadm trigger; then plug it in again"
            )
        if self.mbit_s and self.mbit_s < 1000:
            return f"{self.name} runs at USB 2 ({self.mbit_s:g} Mbit/s): use a USB 3 port and its own cable"
        return ""


def plugged(driver: str, sysfs: Path = SYSFS, nodes: Path = NODES) -> tuple[Plugged, ...]:
    """The cameras of a driver on the USB; none where the machine has no sysfs."""
    return tuple(found for folder in sorted(sysfs.glob("*")) for found in _look(driver, folder, nodes))


def _look(driver: str, folder: Path, nodes: Path) -> Iterator[Plugged]:
    vendor, product, name = (_read(folder / part) for part in ("idVendor", "idProduct", "product"))
    for kind in KINDS:
        if kind.driver != driver or kind.vendor != vendor or kind.word not in name:
            continue
        if kind.products and product not in kind.products:
            continue
        bus, number = (int(_read(folder / part) or 0) for part in ("busnum", "devnum"))
        node = nodes / f"{bus:03}" / f"{number:03}"
        speed = _read(folder / "speed")
        yield Plugged(
            kind,
            name or kind.what,
            f"USB {folder.name}",
            os.access(node, os.R_OK | os.W_OK),
            float(speed) if speed.replace(".", "", 1).isdecimal() else 0.0,
        )


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""  # not every entry has every file, and one may vanish while it is looked at
