"""The faults themselves: each is a context that makes something go wrong on entry and lets it be on exit."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from itertools import count

from common.bus import CommandClient, Poller, Subscriber
from common.errors import TagmillError
from common.topics import TOPICS
from tools.bench.chaos.ground import RESERVE_MB, SESSION, SIZE, remount
from tools.bench.chaos.plan import CAMERAS, MINUTE, Fault
from tools.bench.chaos.stack import Stack, send, until

EVERYTHING = "everything"
_CROWD_S = 60.0
_TRIES = 100
_COMMAND_S = 600.0
_BUSY_S = 20.0
_SLOW_S, _QUICK_S = 0.4, 0.1

Context = AbstractContextManager[None]


@dataclass(frozen=True)
class Cause:
    """How a kind of fault is made, what it takes hold of, and whether it needs mounts of our own.

    Two faults that hold one thing don't overlap. ``holds``: None = the fault's target.
    """

    make: Callable[[Stack, Fault], Context]
    holds: str | None = None
    needs_mounts: bool = False


def _kill(stack: Stack, fault: Fault) -> Context:
    return _kills(stack, fault.target, ())


def _kill_early(stack: Stack, fault: Fault) -> Context:
    return _kills(stack, fault.target, (fault.amount, fault.amount / 3))


@contextmanager
def _kills(stack: Stack, program: str, again_after_s: tuple[float, ...]) -> Iterator[None]:
    """kill -9, and again so long after each restart."""
    pid = stack.pid(program)
    send(pid, signal.SIGKILL)
    for after_s in again_after_s:
        pid = stack.pid(program, other_than=pid)
        Poller().wait(after_s)
        send(pid, signal.SIGKILL)
    yield


@contextmanager
def _kill_worker(stack: Stack, fault: Fault) -> Iterator[None]:
    for worker in stack.workers(fault.target)[:1]:
        send(worker.pid, signal.SIGKILL)
    yield


@contextmanager
def _stop(stack: Stack, fault: Fault) -> Iterator[None]:
    pid = stack.pid(fault.target)
    send(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        send(pid, signal.SIGCONT)


@contextmanager
def _disk_full(stack: Stack, fault: Fault) -> Iterator[None]:
    free_kb = 0 if fault.target == "to the last byte" else RESERVE_MB * 500
    until(lambda: _done(lambda: stack.ground.resize_disk(free_kb)), _BUSY_S, "the disk to become small")
    try:
        yield
    finally:
        stack.ground.resize_disk(None)


@contextmanager
def _disk_slow(stack: Stack, fault: Fault) -> Iterator[None]:  # noqa: ARG001 - all faults have one form
    """The processes that write samples stand still four fifths of the time, as they do in the fsync of a slow disk."""
    over = threading.Event()

    def pulse() -> None:
        while not over.is_set():
            pids = [worker.pid for worker in stack.workers("store")]
            for pid in pids:
                send(pid, signal.SIGSTOP)
            over.wait(_SLOW_S)
            for pid in pids:
                send(pid, signal.SIGCONT)
            over.wait(_QUICK_S)

    thread = threading.Thread(target=pulse, name="disk-slow")
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def _read_only(stack: Stack, fault: Fault) -> Iterator[None]:  # noqa: ARG001
    until(lambda: _done(lambda: remount(stack.ground.disk, "ro")), _BUSY_S, "the disk to become read-only")
    try:
        yield
    finally:
        remount(stack.ground.disk, "rw")


def _done(change: Callable[[], None]) -> bool | None:
    """Whether the disk took a change; it refuses some while a file is being written."""
    try:
        change()
    except TagmillError:
        return None
    return True


def _free_name(stack: Stack) -> str:
    return next(name for number in count(1) if not (stack.ground.root / (name := f"gone-{number}")).exists())


@contextmanager
def _folder_away(stack: Stack, fault: Fault) -> Iterator[None]:  # noqa: ARG001
    """As when a disk is unplugged and comes back. A store that was started meanwhile has made a new session."""
    session = stack.ground.session
    away = session.with_name(_free_name(stack))
    with suppress(FileNotFoundError):
        session.rename(away)
    try:
        yield
    finally:
        with suppress(OSError):
            away.rename(session)


@contextmanager
def _folder_deleted(stack: Stack, fault: Fault) -> Iterator[None]:  # noqa: ARG001
    """Put aside instead of deleted, so that what was acknowledged can still be looked at; then the operator's cure.

    The operator's patience is a thread: control may be standing still just now, and only the storm lets it go on.
    """
    session = stack.ground.session
    with suppress(FileNotFoundError):
        session.rename(session.with_name(_free_name(stack)))
    yield
    stack.cure(lambda: _open_anew(stack))


def _open_anew(stack: Stack) -> None:
    with CommandClient(stack.endpoints) as client:

        def opened() -> bool | None:
            if stack.over.is_set():
                return True
            # A store that was started meanwhile has made the session by itself; then it is in use, and refused.
            with suppress(TagmillError):
                answer = client.request({"command": "session", "name": SESSION})
                return True if answer["ok"] or (stack.ground.session / "session.json").exists() else None
            return None

        until(opened, _COMMAND_S, "the session to be opened anew")


@contextmanager
def _shm_full(stack: Stack, fault: Fault) -> Iterator[None]:
    """Nothing free, and what a dead process had stays taken (we hold it open); then a process that needs some dies."""
    folder = stack.ground.shm
    held = [os.open(path, os.O_RDONLY) for path in folder.iterdir()]
    filler = folder / "filler"
    try:
        with filler.open("wb") as file:
            _take_all(file.fileno())
        send(stack.pid(fault.target), signal.SIGKILL)
        yield
    finally:
        filler.unlink(missing_ok=True)
        for descriptor in held:
            os.close(descriptor)


def _take_all(descriptor: int) -> None:
    """All that is free of a file's disk; the stack takes and gives back meanwhile."""
    taken = 0
    for _ in range(_TRIES):
        told = os.fstatvfs(descriptor)
        free = told.f_bavail * told.f_frsize
        if not free:
            return
        with suppress(OSError):  # somebody else was faster: look again
            os.posix_fallocate(descriptor, taken, free)
            taken += free


@contextmanager
def _unplug(stack: Stack, fault: Fault) -> Iterator[None]:
    cable = stack.ground.cable(fault.target)
    cable.touch()
    try:
        yield
    finally:
        cable.unlink(missing_ok=True)


@contextmanager
def _clock(stack: Stack, fault: Fault) -> Iterator[None]:
    stack.ground.set_clock(fault.amount)
    yield


@contextmanager
def _crowd(stack: Stack, *words: str) -> Iterator[None]:
    command = [sys.executable, "-m", "tools.bench.chaos.crowd", *words]
    with stack.ground.log.open("ab") as sink:
        crowd = subprocess.Popen(command, stdout=sink, stderr=sink)
    try:
        yield
    finally:
        try:
            crowd.wait(_CROWD_S)
        except subprocess.TimeoutExpired:
            crowd.kill()
            crowd.wait()


def _clients(stack: Stack, fault: Fault) -> Context:
    return _crowd(stack, "clients", stack.endpoints.command, str(int(fault.amount)))


@contextmanager
def _viewers(stack: Stack, fault: Fault) -> Iterator[None]:
    with CommandClient(stack.endpoints) as client:

        def url() -> str | None:
            try:
                service = client.request({"command": "status"})["services"].get("console")
            except TagmillError:
                return None
            return None if service is None else service["texts"].get("url")

        place = until(url, _COMMAND_S, "the console's address")
    words = ("viewers", place, CAMERAS[0], str(int(fault.amount)), str(fault.lasts_s), str(SIZE[0]))
    with _crowd(stack, *words):
        yield


@contextmanager
def _deaf(stack: Stack, fault: Fault) -> Iterator[None]:  # noqa: ARG001
    subscriber = Subscriber(stack.endpoints)
    try:
        for topic in TOPICS:
            subscriber.subscribe(topic)
        yield
    finally:
        subscriber.close()


@contextmanager
def _supervisor(stack: Stack, fault: Fault) -> Iterator[None]:
    if fault.target.startswith("kill"):
        stack.kill_supervisor()
    stack.down()
    stack.up()
    yield


CAUSES = {
    "kill -9": Cause(_kill),
    "kill -9 within startsecs": Cause(_kill_early),
    "kill -9 of a worker": Cause(_kill_worker),
    "SIGSTOP, SIGCONT": Cause(_stop),
    MINUTE.name: Cause(_stop),
    "disk full": Cause(_disk_full, "disk", needs_mounts=True),
    "disk slow": Cause(_disk_slow, "store"),
    "disk read-only": Cause(_read_only, "disk", needs_mounts=True),
    "session folder away and back": Cause(_folder_away, "disk"),
    "session folder deleted": Cause(_folder_deleted, "disk"),
    "shared memory full": Cause(_shm_full, needs_mounts=True),
    "camera unplugged": Cause(_unplug),
    "clock set": Cause(_clock, "clock"),
    "1,000 clients": Cause(_clients),
    "subscriber that never reads": Cause(_deaf, "subscriber"),
    "ten viewers": Cause(_viewers, "control"),  # which is asked for the console's address: stopped, it never answers
    "supervisord restarted": Cause(_supervisor, EVERYTHING),
}
