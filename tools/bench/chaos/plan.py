"""What goes wrong, and when: drawn from a seed, so that a run can be repeated. Pure."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass

CAMERAS = ("cam0", "cam1")
PROGRAMS = ("control", "store", "label", "detect", "capture-cam0", "capture-cam1")
_MINUTE = "store stopped for a minute"
_MINUTE_EVERY = 100
_NO_GAP = (0.0, 3.0)
_SHORT_GAP = (0.0, 0.4)
_SHORTER = 0.3


@dataclass(frozen=True)
class Fault:
    """One fault: ``gap_s`` after the one before begins, it holds for ``lasts_s`` (others may begin meanwhile).

    ``amount``: what its kind makes of it (s after a restart, the wall clock's offset in s, how many).
    """

    number: int
    kind: str
    target: str
    gap_s: float
    lasts_s: float
    amount: float


@dataclass(frozen=True)
class Kind:
    """A kind of fault: how often it comes, whom it may meet, how long it holds (s), its amount.

    ``short``: whether it is cheap enough for the short form.
    """

    name: str
    weight: int
    targets: tuple[str, ...]
    lasts_s: tuple[float, float] = (0.0, 0.0)
    amount: tuple[float, float] = (0.0, 0.0)
    short: bool = True


KINDS = (
    Kind("kill -9", 3, PROGRAMS),
    Kind("kill -9 within startsecs", 2, PROGRAMS, amount=(0.0, 2.8)),
    Kind("kill -9 of a worker", 1, ("label", "store")),
    Kind("SIGSTOP, SIGCONT", 3, PROGRAMS, lasts_s=(0.5, 6.0)),
    Kind("disk full", 2, ("but for the ledger", "to the last byte"), lasts_s=(2.0, 5.0)),
    Kind("disk slow", 1, ("store",), lasts_s=(3.0, 6.0)),
    Kind("disk read-only", 1, ("store",), lasts_s=(2.0, 5.0)),
    Kind("session folder away and back", 1, ("store",), lasts_s=(2.0, 5.0)),
    Kind("session folder deleted", 1, ("store",), lasts_s=(2.0, 4.0)),
    Kind("shared memory full", 1, ("capture-cam0", "capture-cam1", "label"), lasts_s=(3.0, 6.0), short=False),
    Kind("camera unplugged", 2, CAMERAS, lasts_s=(1.0, 6.0)),
    Kind("clock set", 1, ("back or on",), amount=(-3600.0, 0.0)),
    Kind("1,000 clients", 1, ("control",), amount=(1000.0, 1000.0), short=False),
    Kind("subscriber that never reads", 1, ("control",), lasts_s=(4.0, 8.0)),
    Kind("ten viewers", 1, ("console",), lasts_s=(4.0, 6.0), amount=(10.0, 10.0), short=False),
    Kind("supervisord restarted", 1, ("down and up", "kill -9 and up"), short=False),
)
MINUTE = Kind(_MINUTE, 0, ("store",), lasts_s=(60.0, 60.0), short=False)


def make_plan(seed: int, count: int, *, short: bool = False) -> tuple[Fault, ...]:
    """``count`` faults; the same for the same arguments. Each kind comes up as often as its weight says.

    The long form stops the store for a whole minute once in a hundred faults.
    """
    chance = random.Random(seed)  # noqa: S311 - a plan that can be repeated, no secret
    faults = []
    deck = _deck(chance, short=short)
    minute = chance.randrange(_MINUTE_EVERY)
    for number in range(count):
        kind = next(deck)
        if not short and number % _MINUTE_EVERY == minute:
            kind = MINUTE
        scale = _SHORTER if short else 1.0
        faults.append(
            Fault(
                number=number,
                kind=kind.name,
                target=chance.choice(kind.targets),
                gap_s=round(chance.uniform(*(_SHORT_GAP if short else _NO_GAP)), 2),
                lasts_s=round(scale * chance.uniform(*kind.lasts_s), 2),
                amount=round(chance.uniform(*kind.amount), 2),
            )
        )
    return tuple(faults)


def _deck(chance: random.Random, *, short: bool) -> Iterator[Kind]:
    """Kinds without end, shuffled round by round."""
    cards = [kind for kind in KINDS if kind.short or not short for _ in range(1 if short else kind.weight)]
    while True:
        chance.shuffle(cards)
        yield from cards
