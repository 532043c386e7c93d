"""Orders: messages that must not be lost. Each has a ``key`` and gets exactly one final answer with that key."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

from common.labels import Label, PairLabel, Part
from common.ledgers import CameraLedger, Ledger, RecordingSpec
from common.messages.samples import SampleFilter, SampleList


class Order(BaseModel):
    """Base of orders; a repeated key is the same order."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    key: str


class ErrorInfo(Part):
    """Why something was refused: a stable code and one sentence."""

    code: str
    message: str


class Answer(BaseModel):
    """The final answer to the order with the same key."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    key: str
    error: ErrorInfo | None = None
    samples: tuple[str, ...] = ()
    pending: tuple[str, ...] = ()
    ledgers: tuple[Ledger, ...] = ()
    text: str | None = None
    listed: SampleList | None = None


# --- control to label -------------------------------------------------------------------------------------


class RecordOrder(Order):
    """Record ``count`` fitting frames of one camera; the answer comes when all are durable or time is up.

    Only frames captured after ``since_mono_ns`` fit, or just ``frame`` (still in the ring). ``pair``: what other
    cameras' frames are taken together with that one.
    """

    kind: Literal["record"] = "record"
    recording: str
    camera: str
    count: int = 1
    interval_s: float = 0.0
    timeout_s: float = 5.0
    since_mono_ns: int = 0
    frame: int | None = None
    background: bool = False
    pair: PairLabel | None = None


class StartOrder(Order):
    """Begin a recording on one camera; answered at once."""

    kind: Literal["start"] = "start"
    spec: RecordingSpec
    camera: str


class StopOrder(Order):
    """End a recording on one camera; answered with its ledger once everything is durable."""

    kind: Literal["stop"] = "stop"
    recording: str
    camera: str


class PreviewOrder(Order):
    """A lease of 5 s for inpainted previews of a camera."""

    kind: Literal["preview"] = "preview"
    camera: str
    inpaint: bool = True


class ReloadOrder(Order):
    """Read the rig file again (control has checked it)."""

    kind: Literal["reload"] = "reload"


# --- label and control to store ---------------------------------------------------------------------------


class StoreOrder(Order):
    """Make a sample durable; ``key`` is its name.

    The pixels lie in slot ``slot`` of the sample ring ``ring`` until the answer. ``urgent``: somebody waits for just
    this one, so that it goes before what recordings have waiting.
    """

    kind: Literal["store"] = "store"
    urgent: bool = False
    recording: str | None
    camera: str
    ring: str
    slot: int
    label: Label


class LedgerOrder(Order):
    """Put one camera's account of a recording into the session's ledger.

    ``spec`` makes the recording known when the ledger doesn't have it yet.
    """

    kind: Literal["ledger"] = "ledger"
    spec: RecordingSpec
    camera: str
    account: CameraLedger
    ended: bool = False
    why: str | None = None


class LedgerQuery(Order):
    """Ask for ledgers: of one recording, or of all that run (``recording`` None)."""

    kind: Literal["query"] = "query"
    recording: str | None = None


class SessionOrder(Order):
    """Open or continue a session by name; ``new_if_different`` starts ``name-2`` ... where the rig differs."""

    kind: Literal["session"] = "session"
    name: str
    new_if_different: bool = False


class MoveOrder(Order):
    """Move samples of the open session ``to`` its bin, or back; those that are there already count as moved."""

    kind: Literal["move"] = "move"
    to: Literal["bin", "session"]
    samples: tuple[str, ...]


class ListOrder(Order):
    """List samples of a session (None: the open one), the newest first."""

    kind: Literal["list"] = "list"
    session: str | None = None
    filter: SampleFilter = SampleFilter()
    offset: int = 0
    limit: int = 100


class NewestOrder(Order):
    """Name the newest sample of the open session, of one camera or of all."""

    kind: Literal["newest"] = "newest"
    camera: str | None = None


LabelOrder = RecordOrder | StartOrder | StopOrder | PreviewOrder | ReloadOrder
StoreSideOrder = (
    StoreOrder | LedgerOrder | LedgerQuery | SessionOrder | ReloadOrder | MoveOrder | ListOrder | NewestOrder
)
