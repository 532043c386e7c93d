"""The ground of a chaos run: a folder with the rig, a disk and a shared memory of its own, a clock that can be set.

Disk and shared memory are small tmpfs, mounted in a mount namespace of the run's own (`unshare`), so that nothing
of them is left however the run ends. Where that isn't allowed, the faults that need them are left out and said so.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import yaml

from common.errors import TagmillError
from tools.bench.chaos.plan import CAMERAS

SIZE = (480, 270)
FPS = 10.0
AHEAD = 8
SESSION = "chaos"
DISK_MB, SHM_MB = 6000, 256
RESERVE_MB = 4
_OFFSET_BYTES = 32
_MOUNT_S = 20.0

_OBJECT = {
    "name": "box-1",
    "size_mm": {"width": 400, "height": 300, "depth": 300},
    "sides": {
        face: {"marker": marker, "marker_size_mm": 150, "border_mm": 15}
        for marker, face in enumerate(("front", "left", "right", "back", "top"))
    },
}


@dataclass(frozen=True)
class Ground:
    """Where everything is. ``mounted``: whether disk and shared memory are small ones of our own."""

    folder: Path
    mounted: bool

    @property
    def rig(self) -> Path:
        """The rig file."""
        return self.folder / "rig.yaml"

    @property
    def disk(self) -> Path:
        """The dataset's disk."""
        return self.folder / "disk"

    @property
    def root(self) -> Path:
        """The dataset's root; beside the session there may be ``gone-N``, where deleted ones were put."""
        return self.disk / "dataset"

    @property
    def session(self) -> Path:
        """The session's folder."""
        return self.root / SESSION

    @property
    def shm(self) -> Path:
        """The folder of the segments."""
        return self.folder / "shm"

    @property
    def clock(self) -> Path:
        """The wall clock's offset."""
        return self.folder / "clock"

    @property
    def journal(self) -> Path:
        """The client's log of answers."""
        return self.folder / "answers.jsonl"

    @property
    def truth(self) -> Path:
        """What each frame must look like."""
        return self.folder / "truth.json"

    @property
    def log(self) -> Path:
        """What `up` and `down` said."""
        return self.folder / "stack.log"

    def cable(self, camera: str) -> Path:
        """The file that unplugs a camera."""
        return self.folder / f"{camera}.unplugged"

    def environment(self) -> dict[str, str]:
        """What the stack's processes must know of it."""
        return {
            "TAGMILL_SHM_DIR": str(self.shm),
            "TAGMILL_WALL_OFFSET_FILE": str(self.clock),
            "TAGMILL_STORE_RESERVE_MB": str(RESERVE_MB),
        }

    def set_clock(self, offset_s: float) -> None:
        """Set the wall clock of the whole stack off by so many seconds."""
        descriptor = os.open(self.clock, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            os.pwrite(descriptor, f"{offset_s:.3f}".ljust(_OFFSET_BYTES).encode(), 0)
        finally:
            os.close(descriptor)

    def resize_disk(self, free_kb: int | None) -> None:
        """Leave so much room on the disk, None: all that there was; raises TagmillError if that is refused."""
        used_kb = -(-(shutil.disk_usage(self.disk).used) // 1024)
        size_kb = DISK_MB * 1024 if free_kb is None else max(used_kb + free_kb, 4)
        remount(self.disk, f"size={size_kb}k")


def prepare(folder: Path, *, console: bool) -> Ground:
    """Make the folder, mount the disks, write the rig."""
    folder.mkdir()
    ground = Ground(folder, _mount(folder / "disk", DISK_MB) and _mount(folder / "shm", SHM_MB))
    ground.root.mkdir()
    ground.set_clock(0.0)
    cameras = {
        name: {
            "driver": "synthetic",
            "width": SIZE[0],
            "height": SIZE[1],
            "fps": FPS,
            "seed": number + 1,
            "prerendered": AHEAD,
            "burn_frame": True,
            "noise": 1.0,
            "speed": 2.0,
            "cable": ground.cable(name).name,
        }
        for number, name in enumerate(CAMERAS)
    }
    rig = {
        "dataset": {"root": "./disk/dataset", "session": SESSION, "keep_original": True},
        "objects": [_OBJECT],
        "pose": {"ambiguous": "keep"},
        "record": {"incomplete": "keep"},
        "ring": {"slots": 12, "samples": 16},
        "cameras": cameras,
    }
    if not console:
        rig["network"] = {"console": None}
    ground.rig.write_text(yaml.safe_dump(rig))
    return ground


def clear(ground: Ground) -> None:
    """Take the disks away."""
    for folder in (ground.disk, ground.shm) if ground.mounted else ():
        _run("umount", "--lazy", str(folder))


def remount(folder: Path, options: str) -> None:
    """Change a mounted disk's options; raises TagmillError if it is refused (e.g. read-only while it is written)."""
    done = _run("mount", "-o", f"remount,{options}", str(folder))
    if done.returncode:
        raise TagmillError(f"{folder} can't be remounted with {options}: {done.stderr.strip()}")


def _mount(folder: Path, megabytes: int) -> bool:
    folder.mkdir()
    return _run("mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", str(folder)).returncode == 0


def _run(*command: str) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=_MOUNT_S, check=False)
    except FileNotFoundError:
        return subprocess.CompletedProcess(command, 1, "", f"there is no {command[0]}")
