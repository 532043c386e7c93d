"""Which source plays a path; what needs a library that isn't installed says which."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from common.config.models import FilesOptions
from common.errors import ConfigError
from services.capture.cameras.file_sources import PictureSource, Source
from services.capture.cameras.pictures import PICTURES

BAGS = frozenset({".bag", ".db3", ".mcap"})
_BAG_FOLDER = "metadata.yaml"
_AZURE_MARK = b"K4A_"
_HEAD_BYTES = 1 << 16


def open_source(name: str, path: Path, depth_path: Path | None, options: FilesOptions) -> Source:
    """Pictures, a video, an Azure Kinect recording or a ROS bag, by what is at ``path``.

    Raises CameraError if it can't be read, ConfigError for keys that don't fit or a library that is missing.
    """
    if path.suffix.lower() in BAGS or (path / _BAG_FOLDER).is_file():
        _need(name, path, "a bag", "rosbags", "bags")
        from services.capture.cameras.bags import BagSource

        _refuse_depth_path(name, depth_path, "a bag", "name its topic as `depth_topic`")
        return BagSource(name, path, options)
    if not path.is_file() or path.suffix.lower() in PICTURES:
        return PictureSource(path, depth_path)
    if _is_azure(path):
        _need(name, path, "an Azure Kinect recording", "av", "video")
        from services.capture.cameras.azure_recording import AzureSource

        _refuse_depth_path(name, depth_path, "an Azure Kinect recording", "it has its own depth")
        return AzureSource(path)
    if find_spec("av") is not None:
        from services.capture.cameras.exact_videos import ExactVideoSource

        return ExactVideoSource(path, depth_path)
    from services.capture.cameras.videos import VideoSource

    return VideoSource(path, depth_path)


def _need(name: str, path: Path, what: str, module: str, extra: str) -> None:
    if find_spec(module) is None:
        raise ConfigError(
            f"cameras.{name}.path: {path} is {what}, which needs the package {module}; pip install 'tagmill[{extra}]'"
        )


def _refuse_depth_path(name: str, depth_path: Path | None, what: str, instead: str) -> None:
    if depth_path is not None:
        raise ConfigError(f"cameras.{name}.depth_path: {what} takes no depth pictures from a folder; {instead}")


def _is_azure(path: Path) -> bool:
    """Whether a Matroska file has the tags that the Azure Kinect's recorder writes near its beginning."""
    if path.suffix.lower() != ".mkv":
        return False
    with path.open("rb") as file:
        return _AZURE_MARK in file.read(_HEAD_BYTES)
