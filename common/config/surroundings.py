"""What a rig needs around it: driver names, addresses, folders, files."""

from __future__ import annotations

import glob
import os
from importlib.metadata import entry_points
from pathlib import Path
from urllib.parse import urlsplit

from common.addresses import is_local
from common.config.models import DRIVER_OPTIONS, CameraConfig, FilesOptions, NetworkConfig
from common.config.problems import FieldPath, Problems, suggestion
from common.config.realsense import RealSenseOptions
from common.config.tree import Tree

DRIVERS_GROUP = "tagmill.cameras"


def known_drivers() -> tuple[str, ...]:
    """Names of the built-in drivers and of those that installed packages bring; nothing is imported."""
    return tuple(sorted({*DRIVER_OPTIONS, *entry_points(group=DRIVERS_GROUP).names}))


def check_driver(tree: Tree, name: str, camera: CameraConfig, problems: Problems) -> None:
    """Note a driver that nobody provides."""
    known = known_drivers()
    if camera.driver not in known:
        found = tree.nearest(("cameras", name, "driver"))
        hint = suggestion(camera.driver, known)
        problems.add(
            found.line,
            found.path,
            f"there is no driver '{camera.driver}'{hint}; known are {', '.join(known)} "
            f"(a package brings further ones under the entry points {DRIVERS_GROUP})",
        )


def check_network(tree: Tree, network: NetworkConfig, folder: Path, problems: Problems) -> None:
    """Note addresses that can't be, and a command socket that anybody could reach without a key."""

    def note(key: str, reason: str) -> None:
        at = tree.nearest(("network", key))
        path: FieldPath = at.path if at.path[-1:] == (key,) else ("network", key)
        problems.add(at.line, path, reason)

    fault = _endpoint_fault(network.command)
    if fault:
        note("command", f"'{network.command}' is no ZeroMQ address: {fault}; e.g. tcp://127.0.0.1:5750")
    elif network.keys is None and not is_local(network.command):
        note(
            "command",
            f"'{network.command}' can be reached from other machines; name a folder of CURVE keys under "
            "network.keys (tagmill keys makes them), or use tcp://127.0.0.1:5750",
        )
    if network.keys is not None and not (folder / network.keys).is_dir():
        note("keys", f"there is no folder {(folder / network.keys).resolve()}; tagmill keys makes one")
    fault = _console_fault(network.console) if network.console is not None else ""
    if fault:
        note("console", f"'{network.console}' is no console address: {fault}; e.g. http://127.0.0.1:8750")


def check_dataset_root(tree: Tree, root: Path, problems: Problems) -> None:
    """Note a dataset root that is, or lies below, something other than a folder."""
    for place in (root, *root.parents):
        if place.is_dir():
            return
        if place.exists() or place.is_symlink():
            found = tree.nearest(("dataset", "root"))
            path: FieldPath = ("dataset", "root")
            problems.add(found.line, path, f"{place} is not a folder, so no samples can be stored in {root}")
            return


def unwritable(root: Path) -> str:
    """What keeps this user from writing below a dataset root, empty if nothing does: it may be mended later."""
    place = next((place for place in (root, *root.parents) if place.is_dir()), root)
    if os.access(place, os.W_OK | os.X_OK):
        return ""
    return (
        f"{place} can't be written, so samples in {root} will be refused; give this user the right to, or name another "
        "dataset.root"
    )


def check_inputs(tree: Tree, name: str, camera: CameraConfig, folder: Path, problems: Problems) -> None:
    """Note files that a camera plays or reads and that are not there."""
    inputs: tuple[tuple[str, Path | None], ...] = ()
    if camera.driver == "files":
        files = FilesOptions.model_validate(camera.options)
        inputs = (("path", files.path), ("depth_path", files.depth_path))
    elif camera.driver == "realsense":
        realsense = RealSenseOptions.model_validate(camera.options)
        inputs = (("recording", realsense.recording), ("preset_file", realsense.preset_file))
    for key, path in inputs:
        if path is None:
            continue
        resolved = (folder / path).resolve()
        if not resolved.exists() and next(glob.iglob(str(resolved)), None) is None:  # noqa: PTH207 - absolute pattern
            found = tree.nearest(("cameras", name, key))
            problems.add(found.line, found.path, f"there is nothing at {resolved}")


def _endpoint_fault(address: str) -> str:
    """Why a command address can't be one, empty if it can."""
    transport, separator, rest = address.partition("://")
    if not separator or transport not in {"tcp", "ipc"}:
        return "it begins with tcp:// or ipc://"
    if transport == "ipc":
        return "" if rest else "the path is missing"
    host, _, port = rest.rpartition(":")
    if not host:
        return "it needs a host and a port"
    return _port_fault(port)


def _port_fault(port: str) -> str:
    return "" if port.isascii() and port.isdigit() and 0 < int(port) < 65536 else "the port must be 1 to 65535"


def _console_fault(address: str) -> str:
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError:
        return "the port must be 1 to 65535"
    if parts.scheme != "http" or not parts.hostname:
        return "it begins with http:// and a host"
    return "the port is missing" if port is None else ""
