"""The table of drivers: lazy, and its errors carry the cure."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from common.config import Rig
from common.config.models import DRIVER_OPTIONS
from common.errors import ConfigError
from services.capture.cameras import registry
from services.capture.cameras.files import FilesCamera
from tests.support import third_party
from tests.unit.services.capture.conftest import write_pictures

ROOT = Path(__file__).resolve().parents[4]


def install(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, target: str, module: str) -> None:
    """A third party's package on this process's path."""
    third_party.install(folder, name, module, target.rpartition(":")[2])
    monkeypatch.syspath_prepend(str(folder))


def test_the_built_in_drivers_are_those_that_the_rig_file_knows() -> None:
    assert set(registry.BUILT_IN) == set(DRIVER_OPTIONS)
    assert set(registry.known_drivers()) >= {"files", "synthetic"}


def test_a_driver_is_imported_when_it_is_asked_for() -> None:
    script = (
        "import sys; from services.capture.cameras.registry import known_drivers, load_driver; known_drivers();"
        "loaded = lambda: [n for n in ('files', 'synthetic') if 'services.capture.cameras.' + n in sys.modules];"
        "print(loaded()); load_driver('files'); print(loaded())"
    )
    found = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    assert found.stdout.split("\n")[:2] == ["[]", "['files']"]


def test_a_camera_is_opened_by_its_drivers_name(rig_of: Callable[[str], Rig], tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 1)
    rig = rig_of("{driver: files, path: photos}")
    assert isinstance(registry.open_camera("cam0", rig.camera("cam0"), rig), FilesCamera)


def test_an_unknown_driver_is_told_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match="unknown camera driver 'file'; did you mean 'files'"):
        registry.load_driver("file")
    with pytest.raises(ConfigError, match=r"unknown camera driver 'zzz'; known: files, .*synthetic"):
        registry.load_driver("zzz")


def test_a_third_partys_driver_comes_by_its_entry_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, monkeypatch, "acme", "acme_module:AcmeCamera", "class AcmeCamera: pass\n")
    assert "acme" in registry.known_drivers()
    assert registry.load_driver("acme").__name__ == "AcmeCamera"  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("module", "told"),
    [
        ("import no_such_sdk\n", "driver 'broken' can't be used: No module named 'no_such_sdk'; reinstall the package"),
        ("", "driver 'broken' is damaged"),
    ],
)
def test_a_missing_sdk_costs_its_camera_and_tells_the_cure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, told: str
) -> None:
    install(tmp_path, monkeypatch, "broken", "broken_module:BrokenCamera", module)
    monkeypatch.delitem(sys.modules, "broken_module", raising=False)
    with pytest.raises(ConfigError, match=told) as caught:
        registry.load_driver("broken")
    assert caught.value.exit_code == 78
    assert registry.load_driver("files") is FilesCamera
