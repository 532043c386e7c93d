from pathlib import Path

import pytest

from common.config import load_rig
from common.dataset import StackLife, read_session, write_bytes
from common.errors import DatasetError, RefusedError
from common.ledgers import CameraLedger
from common.messages import LedgerOrder
from services.store.sessions import OpenSession, SessionDiffersError, Wanted, open_session
from tests.support.mounts import make_read_only, small_disk
from tests.support.samples import START_NS, spec
from tests.support.stack import RIG, write_rig

LIFE = StackLife(pid=1, started=1, machine_boot="a")
OTHER_RIG = RIG.replace("width: 400", "width: 410")


def wanted(folder: Path, rig: str = RIG, life: StackLife = LIFE, *, new: bool = False, name: str = "test") -> Wanted:
    loaded = load_rig(write_rig(folder, rig))
    return Wanted(folder / "data", name, loaded, life, new_if_different=new)


def opened(want: Wanted) -> OpenSession:
    """Opened and closed again."""
    session = open_session(want, reserve=0)
    session.lock.release()
    return session


def test_a_new_session_is_made_and_continued(tmp_path: Path) -> None:
    first = opened(wanted(tmp_path))
    assert first.created
    assert first.folder == tmp_path / "data" / "test"
    assert {path.name for path in first.folder.iterdir()} == {"session.json", "rgb", "depth", "label"}
    written = (first.folder / "session.json").read_bytes()
    second = opened(wanted(tmp_path))
    assert not second.created
    assert (first.folder / "session.json").read_bytes() == written
    assert read_session(first.folder).versions.keys() >= {"tagmill", "numpy", "python"}


def test_another_rig_is_refused_with_its_differences(tmp_path: Path) -> None:
    folder = opened(wanted(tmp_path)).folder
    before = (folder / "session.json").read_bytes()
    with pytest.raises(SessionDiffersError, match=r"objects.box-1.size_mm.width: 400 -> 410") as caught:
        open_session(wanted(tmp_path, OTHER_RIG), reserve=0)
    assert caught.value.code == "session_differs"
    assert (folder / "session.json").read_bytes() == before
    opened(wanted(tmp_path))


def test_unless_a_new_one_is_asked_for(tmp_path: Path) -> None:
    opened(wanted(tmp_path))
    assert opened(wanted(tmp_path, OTHER_RIG, new=True)).folder.name == "test-2"
    assert opened(wanted(tmp_path, RIG.replace("height: 300", "height: 301"), new=True)).folder.name == "test-3"
    again = opened(wanted(tmp_path, OTHER_RIG, new=True))
    assert (again.folder.name, again.created) == ("test-2", False)
    assert opened(wanted(tmp_path, new=True)).folder.name == "test"


def test_an_added_camera_is_no_difference(tmp_path: Path) -> None:
    opened(wanted(tmp_path))
    session = opened(wanted(tmp_path, RIG.replace("ring:", "  cam2: {driver: synthetic}\nring:")))
    assert set(read_session(session.folder).rig["cameras"]) == {"cam0", "cam1", "cam2"}
    opened(wanted(tmp_path))
    assert set(read_session(session.folder).rig["cameras"]) == {"cam0", "cam1", "cam2"}


def test_two_stores_do_not_write_one_session(tmp_path: Path) -> None:
    held = open_session(wanted(tmp_path), reserve=0)
    with pytest.raises(RefusedError, match="another tagmill") as caught:
        open_session(wanted(tmp_path), reserve=0)
    assert caught.value.code == "session_busy"
    assert open_session(wanted(tmp_path), 0, held) is held
    with pytest.raises(SessionDiffersError):
        open_session(wanted(tmp_path, OTHER_RIG), 0, held)
    held.lock.release()


def test_a_recording_of_an_earlier_stack_is_closed_on_the_disk(tmp_path: Path) -> None:
    session = opened(wanted(tmp_path))
    account = CameraLedger(captured=2, pending=2)
    session.book.merge(LedgerOrder(key="k", spec=spec(), camera="cam0", account=account), START_NS)
    write_bytes(session.folder / "session.json", session.book.snapshot().to_bytes())
    assert opened(wanted(tmp_path)).interrupted == ()
    later = StackLife(pid=1, started=2, machine_boot="a")
    assert opened(wanted(tmp_path, life=later)).interrupted == ("rec-a",)
    assert read_session(session.folder).recordings["rec-a"].phase == "interrupted"


@pytest.mark.parametrize(("text", "code"), [("{", "bad_dataset"), ('{"schema": "tagmill.session/7"}', "other_schema")])
def test_a_session_file_that_can_not_be_read_is_not_replaced(tmp_path: Path, text: str, code: str) -> None:
    folder = opened(wanted(tmp_path)).folder
    (folder / "session.json").write_text(text)
    with pytest.raises(DatasetError) as caught:
        open_session(wanted(tmp_path), reserve=0)
    assert caught.value.code == code
    assert (folder / "session.json").read_text() == text


def test_no_room_and_no_right_to_write(tmp_path: Path) -> None:
    with small_disk(tmp_path / "data", 1) as disk:
        with pytest.raises(RefusedError) as caught:
            open_session(wanted(tmp_path), reserve=2 << 20)
        assert caught.value.code == "disk_full"
        opened(wanted(tmp_path))
        make_read_only(disk)
        opened(wanted(tmp_path))
        with pytest.raises(OSError, match="Read-only"):
            open_session(wanted(tmp_path, name="other"), reserve=0)
