"""The ledger: what became of every frame of a recording. Same types on the bus and in ``session.json``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from common.labels import Part

LABEL_RESTART = "label_restart"
"""Where frames are dropped whose fate a label process took with it."""
ALIVE = ("running", "finishing")
"""The phases of a recording that has not ended."""


class Gap(Part):
    """A time in which a camera gave no picture: from its last one before to its first one after (ISO UTC).

    ``to`` and ``seconds`` are None while it lasts. ``reason`` is the camera's own last error, if it told one.
    """

    since: Annotated[str, Field(alias="from")]
    to: str | None = None
    seconds: float | None = None
    reason: str
    since_wall_ns: int


class CameraLedger(Part):
    """One camera's account in a recording: captured = recorded + refused + dropped once it is settled.

    ``deleted``: how many of the ``recorded`` are in the bin, or were removed from it for good.
    ``gaps``: when the camera gave nothing, the first hundred; ``gaps_unlisted`` counts further ones.
    """

    captured: int = 0
    detected: dict[str, int] = {}
    labelled: int = 0
    recorded: int = 0
    refused: dict[str, int] = {}
    dropped: dict[str, int] = {}
    pending: int = 0
    deleted: int = 0
    last_count: int = 0
    boot: str = ""
    gaps: tuple[Gap, ...] = ()
    gaps_unlisted: int = 0

    @property
    def settled(self) -> bool:
        """Whether every captured frame is accounted for."""
        return self.captured == self.recorded + sum(self.refused.values()) + sum(self.dropped.values())


RecordingMode = Literal["record", "all", "auto"]
RecordingPhase = Literal["running", "finishing", "ended", "interrupted"]


class AutoLimits(Part):
    """What `mode: auto` takes: a view that is new (by so many degrees *or* so many mm), sharp, and fits well.

    ``sharpness``: 100 = a marker's edge goes from black to white within one pixel, 10 = within ten; 0 = not looked at.
    ``fit_px``: the highest reprojection error (rms).
    """

    new_deg: Annotated[float, Field(gt=0, le=180)] = 12.0
    new_mm: Annotated[float, Field(gt=0, le=100_000)] = 80.0
    sharpness: Annotated[float, Field(ge=0, le=100)] = 12.0
    fit_px: Annotated[float, Field(gt=0, le=100)] = 1.5


class RecordingSpec(Part):
    """What was asked for. ``spread_ms``: how far apart in time the frames are that several cameras took together.

    ``auto``: with the mode `auto` only.
    """

    recording: str
    mode: RecordingMode
    cameras: tuple[str, ...]
    every_s: float = 0.0
    until_count: int | None = None
    background: bool = False
    started_at: str
    spread_ms: float | None = None
    auto: AutoLimits | None = None


class Ledger(Part):
    """The account of one recording, by camera."""

    spec: RecordingSpec
    phase: RecordingPhase
    ended_at: str | None = None
    why: str | None = None
    cameras: dict[str, CameraLedger]


def with_recorded(account: CameraLedger, counted: int) -> CameraLedger:
    """The account, where it lags behind the samples that are durable (``counted``)."""
    # The account may be ahead too: a sample that two recordings share carries the name of only one of them.
    more = counted - account.recorded
    if more <= 0:
        return account
    told = counted + sum(account.refused.values()) + sum(account.dropped.values())
    surplus = max(told - account.captured, 0)
    # A sample that was on its way when the label process died was first given up, and became durable all the same.
    given_up = account.dropped.get(LABEL_RESTART, 0)
    found = min(surplus, given_up)
    unheard = surplus - found
    dropped = {place: frames for place, frames in account.dropped.items() if place != LABEL_RESTART}
    if given_up > found:
        dropped[LABEL_RESTART] = given_up - found
    return account.model_copy(
        update={
            "recorded": counted,
            "pending": max(account.pending - more, 0),
            "captured": account.captured + unheard,
            # Frames that the account hadn't heard of: they follow its last one, and must not be counted again.
            "last_count": account.last_count + (unheard if account.boot else 0),
            "dropped": dropped,
        }
    )


def with_deleted(ledger: Ledger, deleted: Mapping[str, int]) -> Ledger:
    """The ledger with these counts of deleted samples by camera."""
    if all(account.deleted == deleted.get(camera, 0) for camera, account in ledger.cameras.items()):
        return ledger
    cameras = {
        camera: account.model_copy(update={"deleted": deleted.get(camera, 0)})
        for camera, account in ledger.cameras.items()
    }
    return ledger.model_copy(update={"cameras": cameras})


def closed(ledger: Ledger, ended_at: str, why: str) -> Ledger:
    """The ledger as ``interrupted``: frames without a fate are counted as dropped, nobody is left to tell theirs."""
    cameras = {camera: _settled(account) for camera, account in ledger.cameras.items()}
    return ledger.model_copy(
        update={"phase": "interrupted", "ended_at": ended_at, "why": why, "cameras": cameras},
    )


def _settled(account: CameraLedger) -> CameraLedger:
    told = account.recorded + sum(account.refused.values()) + sum(account.dropped.values())
    lost = account.captured - told
    dropped = {**account.dropped, "interrupted": account.dropped.get("interrupted", 0) + lost} if lost > 0 else None
    return account.model_copy(
        update={"captured": max(account.captured, told), "dropped": dropped or account.dropped, "pending": 0}
    )
