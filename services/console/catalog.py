"""The open session's samples, as the store lists them: what coverage and the gallery's pictures go by.

Read by the command `samples` when somebody looks for the first time, kept by the news of the store; after a missed
piece of news it is read anew.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from common.messages import MOST_LISTED, SamplesChanged
from services.console.line import Plain

Ask = Callable[[Plain, float], Awaitable[Plain]]

LIST_S = 35.0
_SPARE = 20
"""So many more are asked for than are new: others may have come meanwhile."""


class Catalog:
    """Samples by name, ``stored`` and ``binned``; ``version`` grows with every change."""

    def __init__(self, ask: Ask) -> None:
        self.session: str | None = None
        self.stored: dict[str, Plain] = {}
        self.binned: dict[str, Plain] = {}
        self.version = 0
        self._ask = ask
        self._reading = asyncio.Lock()
        self._wanted = True
        self._new: set[str] = set()
        self._news: tuple[str, int] | None = None
        self._counts: tuple[int, int] | None = None

    # --- news ---------------------------------------------------------------------------------------------

    def hear(self, changed: SamplesChanged) -> None:
        """The store's news; what was moved is moved here, what was stored is asked for by ``refresh``."""
        assert changed.stamp is not None
        before, self._news = self._news, (changed.stamp.boot, changed.stamp.seq)
        if before is not None and self._news != (before[0], before[1] + 1):
            self._wanted = True
        if changed.session != self.session:
            self._wanted = True
        self._counts = (changed.stored, changed.in_bin)
        if self._wanted:
            return
        if changed.what == "stored":
            self._new.update(changed.samples)
            return
        for name in changed.samples:
            self._move(name, to_bin=changed.what == "deleted")
        if self._reading.locked():  # what is being read may be from before
            self._wanted = True

    def heard_session(self, session: str | None) -> None:
        """Which session is open, as control says."""
        if session != self.session:
            self._wanted = True

    def _move(self, name: str, *, to_bin: bool) -> None:
        source, target = (self.stored, self.binned) if to_bin else (self.binned, self.stored)
        item = source.pop(name, None)
        if item is None:
            self._wanted = True
            return
        target[name] = item | {"files": {kind: _moved(path, to_bin) for kind, path in item["files"].items()}}
        self.version += 1

    # --- reading ------------------------------------------------------------------------------------------

    async def refresh(self) -> Plain | None:
        """Bring it up to date; the refusal if the store can't be asked now."""
        async with self._reading:  # who asks meanwhile waits for the same answer
            if self._wanted:
                return await self._read_all()
            if not self._new:
                return None
            return await self._read_new()

    def find(self, name: str, *, binned: bool) -> Plain | None:
        """A sample by its name, None if there is none."""
        return (self.binned if binned else self.stored).get(name)

    async def look_up(self, name: str, *, binned: bool) -> tuple[Plain | None, Plain | None]:
        """A sample by its name, after a refresh where it isn't listed; or None and, if there was one, a refusal."""
        item = self.find(name, binned=binned)
        if item is not None:
            return item, None
        if self.find(name, binned=not binned) is not None:
            self._wanted = True  # whoever moved it may have had the answer before the store's news came here
        refused = await self.refresh()
        return self.find(name, binned=binned), refused

    async def _read_all(self) -> Plain | None:
        self._wanted = False
        self._new.clear()
        found: dict[bool, dict[str, Plain]] = {False: {}, True: {}}
        session: str | None = None
        for binned, items in found.items():
            offset: int | None = 0
            while offset is not None:
                answer = await self._page(offset, MOST_LISTED, binned=binned)
                if not answer.get("ok"):
                    self._wanted = True
                    return answer
                session = answer["session"]
                items.update({item["name"]: item for item in answer["samples"]})
                offset = answer["next_offset"]
        self.session, self.stored, self.binned = session, found[False], found[True]
        self.version += 1
        return None

    async def _read_new(self) -> Plain | None:
        wanted, self._new = self._new, set()
        answer = await self._page(0, min(MOST_LISTED, len(wanted) + _SPARE), binned=False)
        if not answer.get("ok") or answer["session"] != self.session:
            self._wanted = True
            return None if answer.get("ok") else answer
        listed = {item["name"]: item for item in answer["samples"]}
        self.stored.update(listed)
        self.version += 1
        if wanted - listed.keys() - self.binned.keys():  # far behind, or their clock was set back
            self._wanted = True
        return None

    async def _page(self, offset: int, limit: int, *, binned: bool) -> Plain:
        fields: dict[str, Any] = {"command": "samples", "offset": offset, "limit": limit, "filter": {"bin": binned}}
        return await self._ask(fields, LIST_S)


def _moved(path: str, to_bin: bool) -> str:
    plain = path.removeprefix("bin/")
    return f"bin/{plain}" if to_bin else plain
