"""The control process: the bus between all services, the command socket, the roll-call.

Consumes  CAMERA, SERVICE, RECORDING, LABELS (when frames were taken); requests on the command socket.
Produces  SHARES at 1 Hz; orders to label and store; one answer to each request.
States    running. What others lack is theirs to say; `status` shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from common import clock
from common.bus import CommandServer, Poller, Proxy, Publisher, Return, Subscriber
from common.commands import Command, HelpCommand, StatusCommand, command_name
from common.errors import RefusedError
from common.messages import ServiceState, Shares
from common.service import Context, Report
from common.service.meters import Rate, Tally
from common.topics import CAMERA, LABELS, RECORDING, SERVICE, SHARES
from services.control.conversations import MAX_WAITING, Conversations, Keys, Plain, Talk, refusal, refusal_of
from services.control.parsing import parse
from services.control.peers import STORE, Peers
from services.control.record_handlers import RecordHandlers
from services.control.sample_handlers import SampleHandlers
from services.control.stack import Stack
from services.control.stack_handlers import StackHandlers, survey

_SHARES_EVERY_NS = 1_000_000_000
_LOOK_EVERY_NS = 50_000_000
_MAX_AGE_S = 3.0
"""States that were queued while the bus was down say nothing of now."""

_AT_ONCE = (StatusCommand, HelpCommand)
"""Commands that are answered even before control knows the stack."""

Handler = Callable[[Any], Talk]


def handlers(stack: Stack, keys: Keys) -> Mapping[str, Handler]:
    """The handler of each command of the table."""
    recording, samples, whole = RecordHandlers(stack, keys), SampleHandlers(keys), StackHandlers(stack, keys)
    return {
        "status": whole.status,
        "record": recording.record,
        "start": recording.start,
        "stop": recording.stop,
        "ledger": recording.ledger,
        "preview": recording.preview,
        "session": whole.session,
        "reload": whole.reload,
        "undo": samples.undo,
        "delete": samples.delete,
        "restore": samples.restore,
        "samples": samples.samples,
        "help": whole.help,
    }


class ControlService:
    """One a stack."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._keys = Keys(context.boot)
        self._stack = Stack(context.rig, context.endpoints, clock.monotonic_ns())
        self._handlers = handlers(self._stack, self._keys)
        self._parked: list[tuple[Return, Command]] = []
        self._asked = Rate()
        self._refused = Tally()
        self._told_shares: Shares | None = None
        self._shares_due_ns = 0
        self._look_due_ns = 0
        self._draining = False

    def open(self) -> None:
        """The bus first, then the command socket and the ways to the other services."""
        context, endpoints = self._context, self._context.endpoints
        self._proxy = Proxy(endpoints, holder=context.id)
        self._proxy.start()
        keys = context.rig.config.network.keys
        self._commands = CommandServer(endpoints, context.rig.resolve(keys) if keys else None, holder=context.id)
        self._peers = Peers(endpoints, context.rig.config.workers.label)
        self._conversations: Conversations[Return | None] = Conversations(self._peers, self._answer)
        self._publisher = Publisher(endpoints, context.id, context.boot)
        self._subscriber = Subscriber(endpoints)
        for topic in (CAMERA, LABELS, SERVICE, RECORDING):
            self._subscriber.subscribe(topic)
        self._poller = Poller(self._commands, self._subscriber, *self._peers.clients)

    def step(self, timeout_s: float) -> None:
        """One round: news, answers of peers, requests, deadlines, shares."""
        self._poller.wait(timeout_s)
        news = self._hear()
        for answer in self._peers.receive():
            self._conversations.arrived(answer)
        for return_, data in self._commands.receive():
            self._asked.mark()
            self._take(return_, data)
        self._conversations.tick()
        now = clock.monotonic_ns()
        if news or self._parked or now >= self._look_due_ns:  # labelled frames change nothing here, and are many
            self._look_due_ns = now + _LOOK_EVERY_NS
            self._stack.tick(now)
            if self._stack.settled:
                self._begin_parked()
                self._tell_shares()

    def drain(self) -> bool:
        """Nobody is left waiting: what was ordered goes on without its client. True from the second call on."""
        if self._draining:
            return True
        self._draining = True
        self._begin_parked()
        self._conversations.end_all(
            "stopping", "tagmill is going down; what was ordered so far is settled in its ledger"
        )
        return False

    def close(self) -> None:
        """The way to clients first, the bus last; idempotent, also after an open that failed half-way."""
        for name in ("_commands", "_peers", "_subscriber", "_publisher", "_proxy"):
            part = getattr(self, name, None)
            if part is not None:
                part.close()

    def report(self) -> Report:
        """What the heartbeat says."""
        now = clock.monotonic_ns()
        dropped = {f"bus:{kind}": count for kind, count in self._subscriber.bad_kinds.items()}
        if self._commands.unreachable:
            dropped["client_gone"] = self._commands.unreachable
        return Report(
            cameras=self._stack.known_cameras,
            rates={"commands": self._asked.per_second(now)},
            dropped=dropped,
            numbers={
                "waiting": float(self._conversations.waiting + len(self._parked)),
                "orders": float(self._peers.pending),
                "missing": float(len(self._stack.roll_call.missing(self._stack.expected, now))),
            }
            | {f"refused:{code}": float(count) for code, count in self._refused.as_dict().items()},
            last_error="a command failed by a mistake in tagmill; see the log" if self._conversations.bugs else None,
        )

    # --- news ---------------------------------------------------------------------------------------------

    def _hear(self) -> bool:
        """Whether anything but labelled frames was heard."""
        news = False
        for received in self._subscriber.receive(max_age_s=_MAX_AGE_S):
            message = received.message
            news |= received.topic is not LABELS
            self._stack.hear(message, received.stamp.source, received.received_ns)
            if isinstance(message, ServiceState):
                self._peers.heard(message)
                if message.service == STORE and message.boot != self._stack.surveyed_boot:
                    self._conversations.begin(None, survey(self._stack, self._keys, message.boot))
        return news

    def _tell_shares(self) -> None:
        """Once a second, and at once when a camera is new."""
        now, shares = clock.monotonic_ns(), self._stack.shares
        if now >= self._shares_due_ns or shares != self._told_shares:
            self._shares_due_ns, self._told_shares = now + _SHARES_EVERY_NS, shares
            self._publisher.publish(SHARES, (), shares)

    # --- requests -----------------------------------------------------------------------------------------

    def _take(self, return_: Return, data: bytes) -> None:
        try:
            if self._draining:
                raise RefusedError("tagmill is going down and takes no more commands", code="stopping")
            command = parse(data)
        except RefusedError as error:
            self._answer(return_, refusal_of(error))
            return
        if self._stack.settled or isinstance(command, _AT_ONCE):
            self._begin(return_, command)
        elif len(self._parked) >= MAX_WAITING:
            self._answer(return_, refusal("busy", "control has just started and is not ready yet; ask again"))
        else:
            self._parked.append((return_, command))

    def _begin_parked(self) -> None:
        parked, self._parked = self._parked, []
        for return_, command in parked:
            self._begin(return_, command)

    def _begin(self, return_: Return, command: Command) -> None:
        self._conversations.begin(return_, self._handlers[command_name(command)](command))

    def _answer(self, client: Return | None, answer: Plain) -> None:
        if client is None:
            return  # control's own question
        if not answer["ok"]:
            code = answer["error"]["code"]
            self._refused.add(code)
            self._context.log.info("command.refused", code=code, reason=answer["error"]["message"])
        self._commands.answer(client, answer)
