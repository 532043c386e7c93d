"""What every part of the rig file is made of."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A frozen part of the rig file; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")
