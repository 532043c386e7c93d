"""The session that was opened by hand, for as long as the stack lives: a store that is killed goes on in it.

A file in the stack's run folder holds it. It counts in the life of the stack that wrote it only; `tagmill down` and
the next `tagmill up` remove it.
"""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from common.dataset import StackLife, write_bytes

CHOICE_FILE = "store.session"


class Choice(BaseModel):
    """Session ``name`` below ``root`` was opened in this ``life`` of the stack."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    life: StackLife
    root: Path
    name: str


def remember(run_dir: Path, choice: Choice) -> None:
    """Keep the choice durably; raises OSError."""
    write_bytes(run_dir / CHOICE_FILE, choice.model_dump_json().encode())


def recall(run_dir: Path, life: StackLife, root: Path) -> str | None:
    """The session that was chosen in this life of the stack below ``root``; None for the rig's own."""
    try:
        choice = Choice.model_validate_json((run_dir / CHOICE_FILE).read_bytes())
    except (OSError, ValidationError):  # none was chosen, or another tagmill wrote it: then it is another life's
        return None
    return choice.name if (choice.life, choice.root) == (life, root) else None
