"""What `undo`, `delete`, `restore` and `samples` do: orders to the store, which alone moves and lists samples."""

from __future__ import annotations

from collections.abc import Generator
from typing import Literal

from common.commands import DeleteCommand, RestoreCommand, SamplesCommand, UndoCommand
from common.errors import RefusedError
from common.messages import Answer, ListOrder, MoveOrder, NewestOrder, Order
from services.control.conversations import Answers, Batch, Errand, Keys, Talk
from services.control.peers import STORE

MOVE_S = 30.0
LIST_S = 30.0
"""A store that has just opened a session of many samples has to read them first."""


class SampleHandlers:
    """One method a command; each returns the conversation that ends with the client's answer."""

    def __init__(self, keys: Keys) -> None:
        self._keys = keys
        self._undoing = False

    def undo(self, command: UndoCommand) -> Talk:
        """Ask for the newest one's name, then move that: an order which is repeated must not take another one.

        Two at a time would mean the same sample, so the second is refused.
        """
        if self._undoing:
            raise RefusedError("another undo is under way; ask again when it is answered", code="busy")
        self._undoing = True
        try:
            newest = yield from self._ask(NewestOrder(key=self._keys.new("newest"), camera=command.camera), MOVE_S)
            moved = yield from self._move("bin", newest.samples)
        finally:
            self._undoing = False
        return {"samples": list(moved.samples)}

    def delete(self, command: DeleteCommand) -> Talk:
        """To the bin."""
        return {"samples": list((yield from self._move("bin", command.samples)).samples)}

    def restore(self, command: RestoreCommand) -> Talk:
        """Out of the bin."""
        return {"samples": list((yield from self._move("session", command.samples)).samples)}

    def samples(self, command: SamplesCommand) -> Talk:
        """A page of the list."""
        order = ListOrder(
            key=self._keys.new("list"),
            session=command.session,
            filter=command.filter,
            offset=command.offset,
            limit=command.limit,
        )
        listed = (yield from self._ask(order, LIST_S)).listed
        assert listed is not None, "an answer without an error has a list"
        return listed.model_dump(mode="json")

    def _move(self, to: Literal["bin", "session"], samples: tuple[str, ...]) -> Generator[Batch, Answers, Answer]:
        return (yield from self._ask(MoveOrder(key=self._keys.new("move"), to=to, samples=samples), MOVE_S))

    def _ask(self, order: Order, timeout_s: float) -> Generator[Batch, Answers, Answer]:
        (answer,) = yield Batch((Errand(STORE, order),), timeout_s)
        if answer.error is not None:
            raise RefusedError(answer.error.message, code=answer.error.code)
        return answer
