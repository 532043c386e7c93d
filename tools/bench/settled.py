"""The end of a recording: everything in it is durable or refused."""

from __future__ import annotations

from typing import Any

from common import clock
from common.bus import CommandClient, Poller
from common.errors import TagmillError


def settled(client: CommandClient, recording: str, patience_s: float) -> dict[str, Any]:
    """Stop a recording and wait until it has ended; its ledger. Raises TagmillError if it hasn't in that time."""
    stopped = client.request({"command": "stop", "recording": recording}, timeout_s=patience_s)
    ledger: dict[str, Any] | None = stopped["ledgers"][0] if stopped["ok"] else None
    pause, end = Poller(), clock.monotonic_ns() + int(patience_s * 1e9)
    while ledger is None or ledger["phase"] != "ended":
        if clock.monotonic_ns() > end:
            raise TagmillError(f"what was recorded was not durable after {patience_s:g} s: {ledger}")
        pause.wait(0.1)
        ledger = client.request({"command": "ledger", "recording": recording}).get("ledger")
    return ledger
