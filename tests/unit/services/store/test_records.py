"""Single requests' ledgers: a line each, written once, found again after any kill."""

from pathlib import Path

import pytest

from common.config import load_rig
from common.dataset import RECORDS_FILE, SESSION_FILE, SessionFile, read_session, write_bytes
from common.errors import DatasetError
from common.ledgers import CameraLedger, Ledger
from services.store.life import stack_life
from services.store.records import Records
from services.store.sessions import Wanted, open_session
from tests.support.samples import spec
from tests.support.stack import write_rig


def entry(recording: str, camera: str = "cam0", captured: int = 2) -> Ledger:
    request = spec(recording, camera).model_copy(update={"mode": "record"})
    account = CameraLedger(captured=captured, recorded=1, refused={"no_object": captured - 1})
    return Ledger(spec=request, phase="ended", ended_at="x", why="answered", cameras={camera: account})


def test_an_entry_is_written_once_and_found_with_all_its_cameras(tmp_path: Path) -> None:
    records = Records(tmp_path)
    assert records.append([entry("rec-a"), entry("rec-b")]) == [entry("rec-a"), entry("rec-b")]
    assert records.append([entry("rec-a", "cam1")]) == [entry("rec-a", "cam1")]
    assert records.append([entry("rec-a"), entry("rec-b")]) == []
    for read in (records, Records(tmp_path)):
        found = read.find("rec-a")
        assert found is not None
        assert sorted(found.cameras) == ["cam0", "cam1"]
        assert read.find("rec-b") == entry("rec-b")
        assert read.find("rec-c") is None
    totals = Records(tmp_path).totals
    assert (totals["cam0"].captured, totals["cam0"].recorded, totals["cam0"].refused) == (4, 2, {"no_object": 2})
    assert totals["cam1"].captured == 2


def test_a_line_that_a_kill_cut_off_is_dropped(tmp_path: Path) -> None:
    Records(tmp_path).append([entry("rec-a")])
    whole = (tmp_path / RECORDS_FILE).read_bytes()
    (tmp_path / RECORDS_FILE).write_bytes(whole + whole[:-1])
    records = Records(tmp_path)
    assert (tmp_path / RECORDS_FILE).read_bytes() == whole
    records.append([entry("rec-b")])
    assert Records(tmp_path).find("rec-b") == entry("rec-b")


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    Records(tmp_path).append([entry("rec-a")])
    with (tmp_path / RECORDS_FILE).open("ab") as file:
        file.write(b"{}\n")
    with pytest.raises(DatasetError, match="line 2"):
        Records(tmp_path)


def test_requests_that_an_earlier_tagmill_kept_in_the_session_file_move_out(tmp_path: Path) -> None:
    rig = load_rig(write_rig(tmp_path))
    wanted = Wanted(rig.dataset_root, "test", rig, stack_life())
    folder = rig.dataset_root / "test"
    open_session(wanted, 0).lock.release()
    begun = Ledger(spec=spec("rec-started"), phase="ended", cameras={})
    before = read_session(folder).model_copy(update={"recordings": {"rec-a": entry("rec-a"), "rec-started": begun}})
    for _ in range(2):  # the second time as if it had been killed between the two files
        write_bytes(folder / SESSION_FILE, before.to_bytes())
        session = open_session(wanted, 0)
        session.lock.release()
        after: SessionFile = read_session(folder)
        assert list(after.recordings) == ["rec-started"]
        assert after.records["cam0"].captured == 2
        assert session.records.find("rec-a") == entry("rec-a")
    assert len((folder / RECORDS_FILE).read_bytes().splitlines()) == 1
