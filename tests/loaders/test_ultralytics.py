"""Ultralytics' own verdict (`check_det_dataset`, `verify_image_label`) on each YOLO export of 449 samples."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.recorded import samples, write_session
from tools.cli import main

pytestmark = [pytest.mark.long, pytest.mark.loaders]


@pytest.fixture(autouse=True)
def no_monitor(monkeypatch: pytest.MonkeyPatch) -> None:
    """tqdm's thread, which watches progress bars, would outlive the test."""
    import tqdm

    monkeypatch.setattr(tqdm.tqdm, "monitor_interval", 0)


@pytest.fixture(scope="module")
def session449(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sessions") / "paper"
    write_session(folder, samples(449))
    return folder


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["yolo", "yolo-pose", "yolo-obb", "yolo-segment"])
def test_ultralytics_finds_nothing_corrupt(
    name: str, session449: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import ultralytics  # a failure here is what this environment is for: it must be there

    assert ultralytics.__version__
    capsys.readouterr()
    assert main(["export", name, str(session449), "--out", str(tmp_path / "out"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    verdict = next(line for line in told["checks"]["right"] if line.startswith("ultralytics:"))
    count, targets = sum(told["samples"].values()), sum(told["classes"].values())
    assert verdict == f"ultralytics: {count} pictures with {targets} targets, 0 corrupt"
    assert told["checks"]["wrong"] == []


def test_ultralytics_refuses_what_is_wrong(
    session449: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The judge does judge: a label out of its bounds is found, by the same loader."""
    from ultralytics.data.utils import verify_image_label

    assert main(["export", "yolo", str(session449), "--out", str(tmp_path / "out"), "--no-check"]) == 0
    label = min((tmp_path / "out" / "labels" / "train").iterdir())
    picture = next((tmp_path / "out" / "images" / "train").glob(f"{label.stem}.*"))
    label.write_text("0 1.5 0.5 0.2 0.2\n")
    assert verify_image_label((str(picture), str(label), "", False, 4, 0, 0, False))[-2] == 1
