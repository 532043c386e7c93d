"""The list of a session's samples, and the news about them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from common.ids import NAME_PATTERN
from common.labels import Part
from common.messages.base import Message

MOST_LISTED = 500

Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Text = Annotated[str, Field(min_length=1, max_length=200)]


class SampleFilter(BaseModel):
    """Which samples; what is left out doesn't matter. What is asked of objects, one object must have all of."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    object: Annotated[Text | None, Field(description="with this object (its name in the rig)")] = None
    type: Annotated[Text | None, Field(description="with an object of this type")] = None
    side: Annotated[Text | None, Field(description="with this side (its class) seen")] = None
    camera: Annotated[Name | None, Field(description="of this camera")] = None
    recording: Annotated[Name | None, Field(description="of this recording")] = None
    min_distance_mm: Annotated[float | None, Field(ge=0, description="with an object at least so far away")] = None
    max_distance_mm: Annotated[float | None, Field(ge=0, description="with an object at most so far away")] = None
    max_reprojection_px: Annotated[float | None, Field(ge=0, description="with a reprojection error up to this")] = None
    max_uncertainty_mm: Annotated[
        float | None, Field(ge=0, description="with a distance known this well (one sigma)")
    ] = None
    ambiguous: Annotated[bool | None, Field(description="with an object whose pose is (or isn't) ambiguous")] = None
    complete: Annotated[bool | None, Field(description="in which every object has a pose (or not)")] = None
    background: Annotated[bool | None, Field(description="recorded on purpose without an object (or not)")] = None
    bin: Annotated[bool, Field(description="those in the bin instead of those in the session")] = False


class SampleObject(Part):
    """An object of a sample. ``azimuth_deg``, ``elevation_deg``: the direction from it to the camera, in its own frame
    (0, 0 before the front; 90, 0 right; elevation 90 above the top). ``uncertainty_mm``: of the distance, one sigma.
    """

    name: str
    type: str
    sides: tuple[str, ...]
    distance_mm: float
    azimuth_deg: float
    elevation_deg: float
    reprojection_error_px: float
    uncertainty_mm: float | None
    ambiguous: bool
    pose_source: str


class SampleItem(Part):
    """A sample in a list. ``files``: by kind, relative to the session's folder; empty: its label can't be read."""

    name: str
    captured_at: str
    camera: str
    frame: int
    recording: str | None
    complete: bool
    background: bool
    objects: tuple[SampleObject, ...]
    files: dict[str, str]


class SampleList(Part):
    """A part of the samples that match, the newest first. ``total``: how many match; ``next_offset``: where the rest
    begins, None at the end. ``stored`` and ``in_bin``: all of the session's samples.
    """

    session: str
    samples: tuple[SampleItem, ...]
    total: int
    stored: int
    in_bin: int
    next_offset: int | None


class SamplesChanged(Message):
    """Samples were stored, deleted (moved to the bin) or restored, durably.

    ``stored`` and ``in_bin`` count the session's samples after it. A gap in the stamp's ``seq`` means that one was
    missed: ask for the list again.
    """

    session: str
    what: Literal["stored", "deleted", "restored"]
    samples: tuple[str, ...]
    stored: int
    in_bin: int
