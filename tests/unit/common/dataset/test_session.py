import json
from pathlib import Path

import pytest

from common.dataset import SESSION_FILE, SessionCamera, SessionFile, StackLife, read_session
from common.dataset.session import RecordingProgress
from common.errors import DatasetError
from common.ledgers import CameraLedger, Ledger
from tests.support.samples import camera_label, spec


def whole_session() -> SessionFile:
    seen = SessionCamera(
        since="2026-08-30T12:00:00.000Z", camera=camera_label(), depth_unit_mm=0.25, driver="synthetic"
    )
    account = CameraLedger(captured=5, recorded=3, refused={"no_object": 1}, dropped={"detect": 1})
    life = StackLife(pid=7, started=123456, machine_boot="b")
    return SessionFile(
        name="boxes",
        created_at="2026-08-30T12:00:00.000Z",
        rig={"objects": {"box-1": {"size_mm": [1.0, 2.0, 3.0]}}, "cameras": {}},
        versions={"tagmill": "0.1.0"},
        cameras={"cam0": (seen,)},
        recordings={"rec-a": Ledger(spec=spec(), phase="running", cameras={"cam0": account})},
        progress={"rec-a": RecordingProgress(life=life, ended=("cam0",))},
    )


def test_what_is_written_is_read(tmp_path: Path) -> None:
    session = whole_session()
    (tmp_path / SESSION_FILE).write_bytes(session.to_bytes())
    assert read_session(tmp_path) == session
    assert json.loads((tmp_path / SESSION_FILE).read_text())["schema"] == "tagmill.session/1"


def test_another_schema_is_said_clearly(tmp_path: Path) -> None:
    plain = {**json.loads(whole_session().to_bytes()), "schema": "tagmill.session/2", "new_field": 1}
    (tmp_path / SESSION_FILE).write_text(json.dumps(plain))
    with pytest.raises(
        DatasetError, match=r"session.json has schema 'tagmill.session/2', this tagmill reads"
    ) as caught:
        read_session(tmp_path)
    assert caught.value.code == "other_schema"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is not JSON"),
        ("{", "is not JSON"),
        ("[]", "has schema None"),
        ('{"schema": "tagmill.session/1"}', "name: Field required"),
        ('{"schema": "tagmill.session/1", "name": 1}', "name: "),
    ],
)
def test_a_damaged_file_is_said_clearly(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / SESSION_FILE).write_text(text)
    with pytest.raises(DatasetError, match=said) as caught:
        read_session(tmp_path)
    assert str(tmp_path / SESSION_FILE) in caught.value.message


def test_a_missing_file_and_one_that_is_no_text(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="is missing"):
        read_session(tmp_path)
    (tmp_path / SESSION_FILE).write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DatasetError, match="can't be read"):
        read_session(tmp_path)
