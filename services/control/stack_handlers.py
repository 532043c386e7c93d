"""What `status`, `session`, `reload` and `help` do."""

from __future__ import annotations

from collections.abc import Generator

from common import clock
from common.commands import HelpCommand, ReloadCommand, SessionCommand, StatusCommand
from common.config import Rig, differences, load_rig
from common.errors import RefusedError
from common.messages import LedgerQuery, ReloadOrder, SessionOrder
from services.control.conversations import Answers, Batch, Errand, Keys, Talk
from services.control.describe import help_answer
from services.control.peers import STORE
from services.control.stack import Stack
from services.control.status import status_answer

SESSION_S = 15.0
RELOAD_S = 15.0
SURVEY_S = 10.0

_NEEDS_RESTART = ("markers", "network", "workers", "ring")
"""Sections that processes take over at their start only."""


class StackHandlers:
    """One method a command; each returns the conversation that ends with the client's answer."""

    def __init__(self, stack: Stack, keys: Keys) -> None:
        self._stack = stack
        self._keys = keys

    def status(self, _: StatusCommand) -> Talk:
        """From what was heard; nobody is asked, so it answers whatever else is down."""
        yield from ()
        return status_answer(self._stack, clock.monotonic_ns())

    def help(self, _: HelpCommand) -> Talk:
        """The table of commands."""
        yield from ()
        return help_answer()

    def session(self, command: SessionCommand) -> Talk:
        """The store opens the session; it is refused while something is being recorded.

        But where the open session's folder is gone: no recording could be ended there, so they go on in the new one.
        """
        if not self._stack.dataset_is_gone:
            self._refuse_while_recording("another session can't be opened")
        order = SessionOrder(
            key=self._keys.new("session"), name=command.name, new_if_different=command.new_if_different
        )
        (answer,) = yield Batch((Errand(STORE, order),), SESSION_S)
        if answer.error is not None:
            raise RefusedError(answer.error.message, code=answer.error.code)
        self._stack.session = answer.text or command.name
        return {"session": self._stack.session}

    def reload(self, _: ReloadCommand) -> Talk:
        """Check the file; the store takes it over first, because it may still refuse, then label, then control."""
        self._stack.refuse_while_reloading()
        rig = load_rig(self._stack.rig.path)
        changed = changed_sections(self._stack.rig, rig)
        self._refuse_restart(changed)
        if differences(self._stack.rig.as_plain(), rig.as_plain()):
            self._refuse_while_recording("what its labels depend on can't be changed")
        self._stack.reloading = True
        try:
            (stored,) = yield from self._hand_out((STORE,))
            yield from self._hand_out(self._stack.labels)
        finally:
            self._stack.reloading = False
        restart = captures_to_restart(self._stack.rig, rig)
        self._stack.take_over(rig)
        self._stack.session = stored.text or self._stack.session
        return {"changed": list(changed), "restart": list(restart), "warnings": list(rig.warnings)}

    def _hand_out(self, peers: tuple[str, ...]) -> Generator[Batch, Answers, Answers]:
        """A reload order to each; raises RefusedError with what they refuse."""
        orders = tuple(Errand(peer, ReloadOrder(key=self._keys.new("reload"))) for peer in peers)
        answers = yield Batch(orders, RELOAD_S)
        failed = [(peer, answer.error) for peer, answer in zip(peers, answers, strict=True) if answer.error is not None]
        if failed:
            raise RefusedError(
                "; ".join(f"{peer} can't take the rig over: {error.message}" for peer, error in failed),
                code=failed[0][1].code,
            )
        return answers

    def _refuse_restart(self, changed: tuple[str, ...]) -> None:
        bound = [section for section in changed if section in _NEEDS_RESTART]
        if bound:
            raise RefusedError(
                f"{' and '.join(bound)} changed in {self._stack.rig.path}, which only a restart of the stack takes "
                "over; end it with 'tagmill down' and start it again",
                code="needs_restart",
            )

    def _refuse_while_recording(self, what: str) -> None:
        running = self._stack.recordings.open_ids()
        if running:
            raise RefusedError(f"{', '.join(running)} is still running, so {what}; stop it first", code="wrong_state")
        if self._stack.requests:
            raise RefusedError(
                f"a `record` of several samples is under way, so {what}; ask again when it is answered",
                code="wrong_state",
            )


def changed_sections(before: Rig, after: Rig) -> tuple[str, ...]:
    """The sections of the rig file that differ; ``calibrations`` where a calibration file's content does."""
    one, other = before.config.model_dump(), after.config.model_dump()
    changed = [section for section in one if one[section] != other[section]]
    if before.as_plain()["markers"] != after.as_plain()["markers"] and "markers" not in changed:
        changed.append("markers")  # the custom dictionary's file
    if dict(before.calibrations) != dict(after.calibrations):
        changed.append("calibrations")
    return tuple(changed)


def captures_to_restart(before: Rig, after: Rig) -> tuple[str, ...]:
    """The capture services whose camera is described otherwise now; only their own restart takes that over."""
    return tuple(
        f"capture.{name}"
        for name, camera in after.config.cameras.items()
        if name in before.config.cameras
        and (camera != before.config.cameras[name] or before.calibration(name) != after.calibration(name))
    )


def survey(stack: Stack, keys: Keys, boot: str) -> Talk:
    """Ask the store, in its life ``boot``, which session is open; without an answer it is asked again."""
    (answer,) = yield Batch((Errand(STORE, LedgerQuery(key=keys.new("survey"))),), SURVEY_S)
    if answer.error is not None:
        raise RefusedError(answer.error.message, code=answer.error.code)
    stack.session, stack.surveyed_boot = answer.text or stack.session, boot
    return {}
