"""Which cameras are attached, by driver; each driver is asked in a process of its own, all at the same time.

A vendor's library may hang, crash or write on stdout when it looks for devices. Here that costs its own line only.
"""

from __future__ import annotations

import faulthandler
import json
import os
import resource
import select
import signal
import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field

from common import clock
from common.errors import TagmillError
from services.capture.cameras.base import Attached
from services.capture.cameras.registry import known_drivers, load_attached
from services.capture.usb import plugged

DEADLINE_S = 2.0
REAP_S = 0.2
_MUCH = 1 << 20

Search = Callable[[str], list[Attached] | None]


@dataclass(frozen=True, slots=True)
class Found:
    """What one driver says. ``problem``: why it couldn't look, with the cure. ``hints``: what else is to be seen.

    ``lists``: whether the driver can say what is attached at all.
    """

    driver: str
    cameras: tuple[Attached, ...] = ()
    problem: str | None = None
    hints: tuple[str, ...] = ()
    lists: bool = True


@dataclass(eq=False, slots=True)
class _Asked:
    driver: str
    pid: int
    pipe: int
    said: bytearray = field(default_factory=bytearray)


def ask_drivers(
    drivers: Iterable[str] | None = None, deadline_s: float = DEADLINE_S, search: Search | None = None
) -> tuple[Found, ...]:
    """Ask the drivers (default: all that are known), in their order; never longer than the deadline and a moment.

    Has to be called from a process without threads: it forks.
    """
    end_ns = clock.monotonic_ns() + int(deadline_s * 1e9)
    names = known_drivers() if drivers is None else tuple(drivers)
    asked = [_ask(name, search or _search) for name in names]
    waiting = {item.pipe: item for item in asked}
    while waiting and (left_ns := end_ns - clock.monotonic_ns()) > 0:
        for pipe in select.select(list(waiting), [], [], left_ns / 1e9)[0]:
            more = os.read(pipe, _MUCH)
            waiting[pipe].said += more
            if not more:
                del waiting[pipe]
    return tuple(_told(item, hung=item.pipe in waiting, deadline_s=deadline_s) for item in asked)


def _ask(driver: str, search: Search) -> _Asked:
    ours, theirs = os.pipe()
    pid = os.fork()
    if pid:
        os.close(theirs)
        return _Asked(driver, pid, ours)
    try:
        _answer(driver, search, theirs)
    finally:
        os._exit(0)


def _answer(driver: str, search: Search, pipe: int) -> None:
    """In the child: look for cameras, say it on the pipe. What the library prints goes nowhere."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    faulthandler.disable()
    silence = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(silence, stream)
    said: dict[str, object] = {}
    try:
        cameras = search(driver)
        said = {"lists": cameras is not None, "cameras": [asdict(camera) for camera in cameras or ()]}
    except TagmillError as error:
        said = {"problem": error.message}
    except Exception as error:  # noqa: BLE001 - a third party's mistake is its own line, not the list's end
        said = {"problem": f"looking for cameras failed: {type(error).__name__}: {error}"}
    with os.fdopen(pipe, "wb") as out:
        out.write(json.dumps(said).encode())


def _search(driver: str) -> list[Attached] | None:
    search = load_attached(driver)
    return None if search is None else search()


def _told(item: _Asked, *, hung: bool, deadline_s: float) -> Found:
    os.close(item.pipe)
    status = _reap(item.pid, kill=hung)
    hints = tuple(hint for camera in plugged(item.driver) if (hint := camera.hint))
    if hung:
        problem = f"its library has not answered within {deadline_s:g} s; unplug its cameras and plug them in again"
        return Found(item.driver, problem=problem, hints=hints)
    if os.WIFSIGNALED(status):
        name = signal.Signals(os.WTERMSIG(status)).name
        return Found(item.driver, problem=f"its library crashed ({name}) while looking for cameras", hints=hints)
    try:
        said = json.loads(item.said)
        cameras = tuple(Attached(**{**camera, "modes": tuple(camera["modes"])}) for camera in said.get("cameras", ()))
    except (ValueError, TypeError, KeyError):
        return Found(item.driver, problem="its library ended the process that looked for cameras", hints=hints)
    return Found(item.driver, cameras, said.get("problem"), hints, bool(said.get("lists", True)))


def _reap(pid: int, *, kill: bool) -> int:
    """The child's exit status; one that not even SIGKILL ends (it waits inside the kernel) is left to init."""
    if kill:
        os.kill(pid, signal.SIGKILL)
    ended = os.pidfd_open(pid)
    try:
        select.select([ended], [], [], REAP_S)
    finally:
        os.close(ended)
    return os.waitpid(pid, os.WNOHANG)[1]


def main(argv: list[str] | None = None) -> int:
    """``python -m services.capture.attached [DRIVER ...]``: what is found, as one JSON document."""
    names = (sys.argv[1:] if argv is None else argv) or None
    print(json.dumps([asdict(found) for found in ask_drivers(names)]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
