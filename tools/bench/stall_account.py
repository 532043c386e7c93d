"""Whether nothing was lost: the ledgers' sums, and the samples on the disk against what was promised."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from common import clock
from common.bus import Poller
from common.dataset import SessionReader
from common.errors import TagmillError


def account(
    session: SessionReader, ledgers: Mapping[str, Any], *, promised: set[str], pending: set[str], patience_s: float
) -> tuple[int, list[str]]:
    """How many samples there are, and what is wrong, a sentence each.

    ``ledgers``: of one recording, by camera. ``promised``: acknowledged; ``pending``: on their way when their
    order's time was up, so they are there within ``patience_s``.
    """
    wrong = [sentence for name, ledger in ledgers.items() for sentence in _unsettled(name, ledger)]
    lost = promised - set(session.samples())
    wrong += [f"{name} was acknowledged and is not on the disk" for name in sorted(lost)]
    pause, end = Poller(), clock.monotonic_ns() + int(patience_s * 1e9)
    while (late := pending - set(session.samples())) and clock.monotonic_ns() < end:
        pause.wait(0.1)
    wrong += [f"{name} was on its way and never came" for name in sorted(late)]
    names = session.samples()
    wrong += [sentence for name in names for sentence in _torn(session, name)]
    recorded = sum(ledger["recorded"] for ledger in ledgers.values())
    if len(names) < recorded:
        wrong.append(f"the ledger says {recorded} samples, {len(names)} are on the disk")
    return len(names), wrong


def _unsettled(camera: str, ledger: Mapping[str, Any]) -> list[str]:
    told = ledger["recorded"] + sum(ledger["refused"].values()) + sum(ledger["dropped"].values())
    if told == ledger["captured"]:
        return []
    return [f"the ledger of {camera} tells of {told} frames, captured were {ledger['captured']}"]


def _torn(session: SessionReader, name: str) -> list[str]:
    try:
        session.verify(name)
    except TagmillError as error:
        return [error.message]
    return []
