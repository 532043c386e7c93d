"""The rig file's ``dataset`` part."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from common.config.section import Section
from common.ids import NAME_PATTERN

PictureFormat = Literal["png", "jpeg", "webp"]


class DatasetConfig(Section):
    """Where samples go: ``<root>/<session>/``, and how their pictures are written.

    ``quality``: of ``jpeg`` (95 unless given) and ``webp`` (lossless unless given); depth is PNG in any case.
    """

    root: Path = Path("./dataset")
    session: Annotated[str, Field(pattern=NAME_PATTERN)] = "session"
    keep_original: bool = False
    format: PictureFormat = "png"
    quality: Annotated[int, Field(ge=1, le=100)] | None = None

    @field_validator("quality")
    @classmethod
    def _of_a_lossy_format(cls, value: int | None, info: ValidationInfo) -> int | None:
        if value is not None and info.data.get("format") == "png":
            raise PydanticCustomError(
                "said", "png is lossless and has no quality; leave it out, or choose jpeg or webp"
            )
        return value
