"""The session chosen by hand counts in the life of the stack that it was chosen in, and nowhere else."""

from pathlib import Path

from common.dataset import StackLife
from services.store.choice import CHOICE_FILE, Choice, recall, remember

LIFE = StackLife(pid=10, started=100, machine_boot="a")
LATER = StackLife(pid=10, started=200, machine_boot="a")


def test_a_choice_is_found_again_by_the_same_stack_only(tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    assert recall(tmp_path, LIFE, root) is None
    remember(tmp_path, Choice(life=LIFE, root=root, name="b"))
    assert [path.name for path in tmp_path.iterdir()] == [CHOICE_FILE]
    assert recall(tmp_path, LIFE, root) == "b"
    assert recall(tmp_path, LATER, root) is None
    assert recall(tmp_path, LIFE, tmp_path / "elsewhere") is None
    remember(tmp_path, Choice(life=LIFE, root=root, name="c"))
    assert recall(tmp_path, LIFE, root) == "c"


def test_a_file_that_is_none_of_ours_chooses_nothing(tmp_path: Path) -> None:
    (tmp_path / CHOICE_FILE).write_bytes(b"{}")
    assert recall(tmp_path, LIFE, tmp_path) is None
