"""A third party's camera driver for tests: the synthetic camera on a cable that a test can pull."""

from __future__ import annotations

from pathlib import Path

from common.config import Rig
from common.config.models import CameraConfig
from common.errors import CameraError
from services.capture.cameras.base import Camera, Description, Grabbed
from services.capture.cameras.registry import load_driver


class UnpluggableCamera:
    """Driver ``unpluggable``: while the file ``cable`` (beside the rig) exists, the camera is not there."""

    def __init__(self, name: str, config: CameraConfig, rig: Rig) -> None:
        options = dict(config.options)
        self._cable = rig.resolve(Path(str(options.pop("cable", "unplugged"))))
        self._check()
        inner = CameraConfig(
            driver="synthetic",
            width=config.width,
            height=config.height,
            fps=config.fps,
            **options,  # type: ignore[arg-type]
        )
        self._camera: Camera = load_driver("synthetic")(name, inner, rig)

    def grab(self, timeout_s: float) -> Grabbed:
        self._check()
        return self._camera.grab(timeout_s)

    def describe(self) -> Description:
        return self._camera.describe()

    def close(self) -> None:
        self._camera.close()

    def _check(self) -> None:
        if self._cable.exists():
            raise CameraError("the test has pulled the cable; plug it in again")


def install(folder: Path) -> str:
    """Put the driver's package into ``folder`` as pip would leave it; returns the PYTHONPATH that finds it."""
    about = folder / "unpluggable_camera-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: unpluggable-camera\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[tagmill.cameras]\nunpluggable = unpluggable_camera:UnpluggableCamera\n")
    (folder / "unpluggable_camera.py").write_text("from tests.support.unpluggable import UnpluggableCamera\n")
    return str(folder)
