"""The command socket's table: one frozen model a command, what it does, what it answers. Pure.

Control turns bytes into these and carries them out; the console mirrors them as HTTP; `help` and
docs/reference/commands.md are made from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from common.ids import NAME_PATTERN
from common.ledgers import AutoLimits
from common.messages import MOST_LISTED, SampleFilter

ALL_CAMERAS = "all"

Camera = Annotated[str, Field(pattern=NAME_PATTERN, description="a camera's name, or 'all'")]
Recording = Annotated[str, Field(pattern=NAME_PATTERN)]
_AUTO = "with mode 'auto', else as the rig file says: {}"
Background = Annotated[bool, Field(description="record pictures *without* a configured object in view")]


class Command(BaseModel):
    """A request; strict, so that '3' is no number and 1 is no yes."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class StatusCommand(Command):
    """How the whole stack is."""


class RecordCommand(Command):
    """Record samples now."""

    camera: Camera
    count: Annotated[int, Field(ge=1, le=1000, description="how many samples, for each camera")] = 1
    interval_s: Annotated[float, Field(ge=0, le=3600, description="at least this long between two samples")] = 0.0
    timeout_s: Annotated[float, Field(gt=0, le=3600, description="how long to wait for fitting frames")] = 5.0
    frame: Annotated[int | None, Field(ge=1, description="only this frame, if it is still in the ring")] = None
    background: Background = False

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.frame is not None and (self.count != 1 or self.camera == ALL_CAMERAS):
            raise ValueError("'frame' names one frame of one camera: leave 'count' at 1 and name that camera")
        waits = (self.count - 1) * self.interval_s
        if waits and waits >= self.timeout_s:
            raise ValueError(f"{self.count} samples every {self.interval_s:g} s need a 'timeout_s' above {waits:g}")
        return self


class StartCommand(Command):
    """Begin a recording."""

    camera: Camera
    every_s: Annotated[float, Field(ge=0, le=86_400, description="a sample every so often; 0 = each frame")] = 0.0
    until_count: Annotated[int | None, Field(ge=1, le=10_000_000, description="end by itself after so many")] = None
    mode: Annotated[Literal["all", "auto"], Field(description="'auto' takes only new views")] = "all"
    background: Background = False
    new_deg: Annotated[float | None, Field(gt=0, le=180, description=_AUTO.format("new: by so many degrees"))] = None
    new_mm: Annotated[float | None, Field(gt=0, le=100_000, description=_AUTO.format("or by so many mm"))] = None
    sharpness: Annotated[
        float | None, Field(ge=0, le=100, description=_AUTO.format("100: a marker's edge within a pixel, 10: in ten"))
    ] = None
    fit_px: Annotated[float | None, Field(gt=0, le=100, description=_AUTO.format("reprojection error up to"))] = None

    @model_validator(mode="after")
    def _limits_need_auto(self) -> Self:
        given = [name for name in AutoLimits.model_fields if getattr(self, name) is not None]
        if given and self.mode != "auto":
            raise ValueError(f"'{given[0]}' belongs to mode 'auto'")
        return self

    def limits(self, default: AutoLimits) -> AutoLimits | None:
        """The limits of mode `auto`: those given, for the others ``default``; None for mode `all`."""
        if self.mode != "auto":
            return None
        given = {name: getattr(self, name) for name in AutoLimits.model_fields}
        return default.model_copy(update={name: value for name, value in given.items() if value is not None})


class StopCommand(Command):
    """End a recording."""

    recording: Annotated[Recording | None, Field(description="its id; without it, all that run")] = None


class LedgerCommand(Command):
    """What became of every frame of a recording."""

    recording: Annotated[Recording, Field(description="its id, as 'start' answered it")]


class PreviewCommand(Command):
    """Watch a camera's inpainted preview."""

    camera: Camera
    inpaint: Annotated[bool, Field(description="with the markers erased")] = True


class SessionCommand(Command):
    """Open or continue a session."""

    name: Annotated[str, Field(pattern=NAME_PATTERN, description="a folder's name below the dataset's root")]
    new_if_different: Annotated[
        bool, Field(description="where the rig differs from that session's, open name-2, name-3 ... instead")
    ] = False


class ReloadCommand(Command):
    """Take over the changed rig file."""


SampleNames = Annotated[
    tuple[Annotated[str, Field(min_length=1, max_length=120)], ...],
    Field(min_length=1, max_length=MOST_LISTED, description="samples' names"),
]


class UndoCommand(Command):
    """Delete the newest sample."""

    camera: Annotated[str | None, Field(pattern=NAME_PATTERN, description="the newest one of this camera")] = None


class DeleteCommand(Command):
    """Move samples to the bin."""

    samples: SampleNames


class RestoreCommand(Command):
    """Put samples back from the bin."""

    samples: SampleNames


class SamplesCommand(Command):
    """List samples."""

    session: Annotated[str | None, Field(pattern=NAME_PATTERN, description="without it, the one that is open")] = None
    filter: SampleFilter = SampleFilter()
    offset: Annotated[int, Field(ge=0, le=100_000_000, description="pass over so many, the newest first")] = 0
    limit: Annotated[int, Field(ge=0, le=MOST_LISTED, description="at most so many; 0 = only the counts")] = 100


class HelpCommand(Command):
    """This list."""


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the table: ``errors`` are the codes that this command can be refused with, beside `GENERAL_ERRORS`."""

    name: str
    model: type[Command]
    words: str
    answer: str
    errors: tuple[str, ...] = ()


GENERAL_ERRORS = (
    "not_a_command",
    "unknown_command",
    "unknown_field",
    "missing_field",
    "wrong_type",
    "out_of_bounds",
    "busy",
    "stopping",
    "failed",
)
"""What any request can be refused with."""

_LABEL = ("label_down", "timeout", "bad_order")
_STORE = ("store_down", "timeout", "bad_order")
_DISK = ("disk_full", "read_only", "disk_error", "no_dataset")
_SESSION = ("session_differs", "session_busy", "bad_dataset", "other_schema")

COMMANDS: dict[str, Row] = {
    row.name: row
    for row in (
        Row(
            "status",
            StatusCommand,
            "services, cameras, recordings, backlog and free disk, as last heard",
            "services, missing, cameras, recordings, backlog, disk, session, prefix, versions",
        ),
        Row(
            "record",
            RecordCommand,
            "the first fitting frames captured from now on; answers once all are durable, or when time is up",
            "recording, samples (names that are durable), pending (names whose saving is under way), pairs (what "
            "several cameras took together: spread_ms, samples by camera), recordings (an id for each round of "
            "theirs), cameras (with 'all': camera to the reason why it failed)",
            (
                *_LABEL,
                *("no_camera", "no_object", "ambiguous_pose", "incomplete", "object_in_view", "no_frame", "frame_gone"),
                *("frame_lost", "not_due", "bad_pose", "no_pose", "no_space", "backlog_full", "store_down"),
                *("pixels_gone", "worker_died", "bad_sample", "cameras_failed", "detect_down", *_DISK, *_SESSION),
            ),
        ),
        Row(
            "start",
            StartCommand,
            "begin a recording; it ends by 'stop', by 'until_count' or at the end of a file camera",
            "recording (its id), cameras, missing (cameras of the rig that are not there)",
            (*_LABEL, "no_camera", "wrong_state", "cameras_failed"),
        ),
        Row(
            "stop",
            StopCommand,
            "end one recording, or all that run; answers once everything is durable",
            "ledgers",
            (*_LABEL, "no_recording", "store_down", "cameras_failed", *_DISK, *_SESSION),
        ),
        Row(
            "ledger",
            LedgerCommand,
            "what became of every frame of a recording, while it runs and after",
            "ledger",
            (*_STORE, "no_recording", *_DISK, *_SESSION),
        ),
        Row(
            "preview",
            PreviewCommand,
            "a lease of 5 s for inpainted previews of a camera; its viewer renews it",
            "cameras, lease_s",
            (*_LABEL, "no_camera", "cameras_failed"),
        ),
        Row(
            "session",
            SessionCommand,
            "open or continue a session without a restart",
            "session (the name that is open now)",
            (*_STORE, "wrong_state", "bad_name", *_DISK, *_SESSION),
        ),
        Row(
            "reload",
            ReloadCommand,
            "check the rig file again; label, store and control take it over, or it is refused with all its mistakes",
            "changed (sections of the rig file)",
            (*_LABEL, "store_down", "bad_config", "needs_restart", "wrong_state", *_DISK, *_SESSION),
        ),
        Row(
            "undo",
            UndoCommand,
            "delete the newest sample of the open session; asked again, the one before it",
            "samples (the name of the one that is in the bin now)",
            (*_STORE, "nothing_to_undo", "no_sample", *_DISK, *_SESSION),
        ),
        Row(
            "delete",
            DeleteCommand,
            "move samples of the open session to its bin, durably: all of them or, with a refusal, none",
            "samples (those that are in the bin now, also if they were there before)",
            (*_STORE, "no_sample", *_DISK, *_SESSION),
        ),
        Row(
            "restore",
            RestoreCommand,
            "put samples back from the bin, durably: all of them or, with a refusal, none",
            "samples (those that are back now, also if they never were in the bin)",
            (*_STORE, "no_sample", *_DISK, *_SESSION),
        ),
        Row(
            "samples",
            SamplesCommand,
            "a session's samples, the newest first",
            "session, samples, total (how many match), stored and in_bin (all of the session), next_offset (where to "
            "go on, nil at the end: an answer may be cut short)",
            (*_STORE, "unknown_session", *_DISK, *_SESSION),
        ),
        Row("help", HelpCommand, "the commands with their fields", "commands"),
    )
}


def command_name(command: Command) -> str:
    """The name under which a parsed request stands in the table."""
    return next(row.name for row in COMMANDS.values() if row.model is type(command))
