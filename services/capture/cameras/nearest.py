"""Pairing two ordered streams by time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class Nearest(Generic[T]):
    """Finds in a stream of (ns, item) the item nearest to a time; asked for times that never run backwards.

    Reads no further than one item behind the nearest.
    """

    def __init__(self, items: Iterator[tuple[int, T]]) -> None:
        self._items = items
        self._ahead: deque[tuple[int, T]] = deque()

    def at(self, ns: int, within_ns: int) -> T | None:
        """The item nearest to ``ns``; None if there is none within ``within_ns``."""
        while True:
            while len(self._ahead) < 2 and (item := next(self._items, None)) is not None:
                self._ahead.append(item)
            if len(self._ahead) < 2 or abs(self._ahead[1][0] - ns) >= abs(self._ahead[0][0] - ns):
                break
            self._ahead.popleft()
        if not self._ahead or abs(self._ahead[0][0] - ns) > within_ns:
            return None
        return self._ahead[0][1]
