"""The runner: from the command line to the exit code, the same for every service."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from common import clock, errors, log
from common.bus import Endpoints, NameLock, clear_dead, end_context
from common.config import load_rig
from common.errors import ConfigError, NameTakenError, TagmillError
from common.frames import sweep
from common.ids import new_boot
from common.service.arguments import parse, service_id
from common.service.context import Context, Report, Service
from common.service.heartbeat import Heartbeat
from common.service.levels import LevelWatch
from common.service.memory import keep_all
from common.service.parent import die_with_parent
from common.service.signals import DRAIN_S, StopRequest
from common.service.states import Phase, StateMachine
from common.service.supervised import stop_was_asked

STEP_S = 0.25
REPORT_EVERY_NS = 200_000_000
BAD_CONFIG_STAYS_S = 3.2
"""A supervisor with startsecs=3 counts the process as started and then heeds its exit code 78."""

_BACK_OFF_S = (0.1, 0.2, 0.5, 1.0, 2.0)

ServiceFactory = Callable[[Context], Service]


def main(factory: ServiceFactory, name: str, argv: Sequence[str] | None = None) -> int:
    """Run service ``name`` until a signal; returns its exit code (0 asked, 78 configuration, 69 name, 1 bug)."""
    parent = os.getppid()
    started_ns = clock.monotonic_ns()
    stop = StopRequest()
    stop.install()
    code = _guarded(factory, name, argv, stop, parent, started_ns)
    end_context()
    stuck = [thread.name for thread in threading.enumerate() if _is_left(thread)]
    if stuck:
        log.get().error("service.threads_left", threads=stuck)
    log.shutdown()
    stop.uninstall()
    if stuck:
        # Python's own end would tear down what a thread inside a driver still uses: a crash after a clean stop.
        os._exit(code)
    return code


def _guarded(
    factory: ServiceFactory,
    name: str,
    argv: Sequence[str] | None,
    stop: StopRequest,
    parent: int,
    started_ns: int,
) -> int:
    """The service's whole life; every way it can end becomes an exit code here."""
    try:
        return _run(factory, name, argv, stop, parent)
    except ConfigError as error:
        _tell_problems(name, error)
        stop.wait(BAD_CONFIG_STAYS_S - (clock.monotonic_ns() - started_ns) / 1e9)
        return error.exit_code
    except TagmillError as error:
        log.get().error("service.refused", code=error.code, reason=error.message, exit_code=error.exit_code)
        return error.exit_code
    except Exception:  # noqa: BLE001 - the outermost frame: a bug gets its traceback and an exit code
        log.get().exception("service.bug")
        return errors.EXIT_BUG


def _run(factory: ServiceFactory, name: str, argv: Sequence[str] | None, stop: StopRequest, parent: int) -> int:
    args = parse(name, argv)
    own_id = service_id(name, args)
    log.setup(own_id, args.log_level)
    if not die_with_parent(parent):
        stop.ask("parent_died")
    elif stop_was_asked():
        stop.ask("supervisor_stops_it")
    context = _context(name, own_id, args)
    context.endpoints.prepare()
    _sweep(context)
    _limit_threads()
    crashes = _watch_threads(context)
    run = _Run(factory, context, stop, crashes)
    try:
        run.open(args.name_wait_s)
        run.serve()
        run.drain()
    finally:
        run.close()
    if crashes:
        return errors.EXIT_BUG
    return errors.EXIT_OK


class _Run:
    """One life of a service: the state machine, the heartbeat and the service between them."""

    def __init__(self, factory: ServiceFactory, context: Context, stop: StopRequest, crashes: list[str]) -> None:
        self._factory = factory
        self._context = context
        self._stop = stop
        self._crashes = crashes
        self._states = StateMachine()
        self._service: Service | None = None
        self._lock: NameLock | None = None
        self._report = Report()
        self._level = LevelWatch(context.endpoints.run_dir, context.id, context.args.log_level)
        self._heartbeat = Heartbeat(context.endpoints, context.id, context.instance, context.camera, context.boot)

    def open(self, wait_s: float) -> None:
        """Take the name and open the service; a taken name is waited for, at most ``wait_s``."""
        if self._stop.requested:
            return None
        deadline = clock.monotonic_ns() + int(wait_s * 1e9)
        for attempt in range(sys.maxsize):
            try:
                return self._open_once()
            except NameTakenError as error:
                pause_s = _BACK_OFF_S[min(attempt, len(_BACK_OFF_S) - 1)]
                left_s = (deadline - clock.monotonic_ns()) / 1e9
                if left_s <= 0:
                    raise
                if attempt == 0:
                    self._context.log.warning("service.name_taken", reason=error.message, wait_s=wait_s)
                self._give_back()
                if self._stop.wait(min(pause_s, left_s)):
                    return None
        return None

    def serve(self) -> None:
        """Rounds until a stop is requested or a thread crashes."""
        due_ns = 0
        while self._service is not None and not self._ending():
            now = clock.monotonic_ns()
            if now >= due_ns:  # a busy service steps hundreds of times a second
                due_ns = now + REPORT_EVERY_NS
                self._report = self._service.report()
                self._enter(Phase.FAULTY if self._report.faulty else Phase.RUNNING)
                self._heartbeat.beat(self._states.phase, self._report)
                self._level.look()
            self._service.step(STEP_S)

    def drain(self) -> None:
        """Let the service finish what it began, at most ``DRAIN_S``, or until a second signal."""
        if self._service is None or self._crashes:
            return
        self._enter(Phase.DRAINING)
        deadline = clock.monotonic_ns() + int(DRAIN_S * 1e9)
        while not self._service.drain():
            if self._stop.forced or clock.monotonic_ns() > deadline:
                self._context.log.warning("service.drain_cut", forced=self._stop.forced, limit_s=DRAIN_S)
                return
            self._service.step(STEP_S / 5)
            self._report = self._service.report()
            self._heartbeat.beat(self._states.phase, self._report)

    def close(self) -> None:
        """Give everything back, the name last."""
        try:
            self._give_back()
            self._enter(Phase.STOPPED)
            self._heartbeat.beat(self._states.phase, self._report)
        finally:
            self._heartbeat.close()
            if self._lock is not None:
                self._lock.release()
            _clear_leftovers(self._context)

    def _open_once(self) -> None:
        if self._lock is None:
            self._lock = NameLock(self._context.endpoints.service_lock(self._context.id), self._context.id)
        self._heartbeat.beat(Phase.STARTING, Report())
        self._service = self._factory(self._context)
        self._service.open()
        keep_all()
        self._context.log.info("service.opened", boot=self._context.boot, pid=os.getpid())

    def _give_back(self) -> None:
        service, self._service = self._service, None
        if service is not None:
            service.close()

    def _ending(self) -> bool:
        return self._stop.requested or bool(self._crashes)

    def _enter(self, phase: Phase) -> None:
        if self._states.enter(phase):
            self._context.log.info("service.state", phase=phase.value, why=self._stop.why)


def _is_left(thread: threading.Thread) -> bool:
    return thread is not threading.main_thread() and thread.name != log.WRITER_THREAD and thread.is_alive()


def _context(name: str, own_id: str, args: argparse.Namespace) -> Context:
    rig_path: Path = args.rig
    rig = load_rig(rig_path)
    return Context(
        rig=rig,
        endpoints=Endpoints.of(rig.config.network),
        name=name,
        id=own_id,
        instance=args.instance,
        camera=args.camera,
        boot=new_boot(),
        log=log.get(),
        args=args,
    )


def _sweep(context: Context) -> None:
    """Remove segments of dead processes; dead socket files are replaced under their lock by whoever binds them."""
    swept = sweep(context.endpoints.prefix)
    if swept:
        context.log.info("service.swept", removed=swept)


def _clear_leftovers(context: Context) -> None:
    """At the end also lock and socket files: one that is killed just before all are stopped does not come back."""
    _sweep(context)
    cleared = clear_dead(context.endpoints.run_dir)
    if cleared:
        context.log.info("service.cleared", removed=cleared)


def _limit_threads() -> None:
    """Processes are the unit of parallelism; OPENCV_FOR_THREADS_NUM says otherwise where somebody wants it."""
    if "OPENCV_FOR_THREADS_NUM" not in os.environ:
        import cv2

        cv2.setNumThreads(1)


def _watch_threads(context: Context) -> list[str]:
    """A thread that ends by an exception is a bug of the service: it is logged and ends the process."""
    crashes: list[str] = []

    def on_crash(args: threading.ExceptHookArgs) -> None:
        name = "?" if args.thread is None else args.thread.name
        info = (args.exc_type, args.exc_value, args.exc_traceback)
        context.log.error("thread.crashed", thread=name, exc_info=info)
        crashes.append(name)  # last: it ends the main loop, and with it the log

    threading.excepthook = on_crash
    return crashes


def _tell_problems(name: str, error: ConfigError) -> None:
    """All mistakes, for a person: plain lines, after what the log still holds."""
    log.shutdown()
    lines = [f"tagmill {name}: the configuration can't be used:", *(f"  {problem}" for problem in error.problems)]
    with contextlib.suppress(OSError):  # nobody reads stderr any more: the exit code still tells
        print("\n".join(lines), file=sys.stderr, flush=True)
