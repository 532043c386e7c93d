"""Logging: events, not prose; and a reader of the log that stalls never stalls a service.

``setup`` puts a bounded queue and a writer thread between the service and stderr: what finds the queue full is
dropped and counted, and the next line that gets through is preceded by the count (``log.dropped``).
"""

from __future__ import annotations

import atexit
import json
import logging
import os
import queue
import sys
import threading
from collections.abc import MutableMapping
from typing import Any, Literal, cast

import structlog
from structlog.typing import FilteringBoundLogger

from common import clock
from common.errors import TagmillError

Level = Literal["debug", "info", "warning", "error"]

WRITER_THREAD = "log-writer"
_QUEUE_LINES = 2000
_FLUSH_S = 1.0
_NUMBERS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "exception": logging.ERROR}


class QueueWriter:
    """Writes lines to a file descriptor from a thread of its own; ``write`` never blocks.

    ``dropped`` counts lines that found the queue full or the reader of the pipe gone.
    """

    def __init__(self, descriptor: int, size: int = _QUEUE_LINES, service: str = "") -> None:
        self.dropped = 0
        self._service = service
        self._descriptor = descriptor
        self._size = size
        self._guard = threading.Lock()
        self._start()

    def write(self, line: str) -> None:
        """Queue one line (without its end)."""
        if self._pid != os.getpid():
            self._start()  # a forked child has no writer thread
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            with self._guard:
                self.dropped += 1
                self._untold += 1

    def flush(self, timeout_s: float = _FLUSH_S) -> bool:
        """Wait until everything queued so far is written; False if that took longer than ``timeout_s``."""
        if self._pid != os.getpid() or not self._thread.is_alive():
            return True
        done = threading.Event()
        try:
            self._lines.put(done, timeout=timeout_s)
        except queue.Full:
            return False
        return done.wait(timeout_s)

    def close(self, timeout_s: float = _FLUSH_S) -> None:
        """Flush within ``timeout_s`` and end the thread (which is left alone if its pipe is stalled)."""
        if self.flush(timeout_s) and self._pid == os.getpid():
            self._lines.put(None)
            self._thread.join(timeout_s)

    def _start(self) -> None:
        self._pid = os.getpid()
        self._untold = 0
        self._lines: queue.Queue[str | threading.Event | None] = queue.Queue(self._size)
        self._thread = threading.Thread(target=self._run, args=(self._lines,), name=WRITER_THREAD, daemon=True)
        self._thread.start()

    def _run(self, lines: queue.Queue[str | threading.Event | None]) -> None:
        while (line := lines.get()) is not None:
            with self._guard:
                untold, self._untold = self._untold, 0
            if untold:
                self._put(self._told(untold))
            if isinstance(line, threading.Event):
                line.set()
            else:
                self._put(line)

    def _told(self, count: int) -> str:
        line = {"count": count, "event": "log.dropped", "service": self._service, "level": "warning"}
        return json.dumps({**line, "timestamp": clock.iso_utc(clock.wall_ns())})

    def _put(self, line: str) -> None:
        data = line.encode("utf-8", "backslashreplace") + b"\n"
        try:
            while data:
                data = data[os.write(self._descriptor, data) :]
        except OSError:
            with self._guard:
                self.dropped += 1


class _Sink:
    """The logger below structlog's processors: one method for every level."""

    def __init__(self, writer: QueueWriter | None) -> None:
        self._writer = writer

    def msg(self, line: str) -> None:
        if self._writer is None:
            sys.stderr.write(line + "\n")
        else:
            self._writer.write(line)

    debug = info = warning = error = critical = log = msg


class _FromLibraries(logging.Handler):
    """Brings what libraries log into the same stream."""

    def emit(self, record: logging.LogRecord) -> None:
        get().log(record.levelno, "library.said", logger=record.name, text=record.getMessage())


_writer: QueueWriter | None = None
_least = logging.INFO
_service: str | None = None


def setup(service_id: str, level: Level = "info", stream: Any = None) -> QueueWriter:
    """Log as ``service_id`` to ``stream`` (default stderr): readable lines on a terminal, JSON otherwise.

    May be called again; the returned writer counts what was dropped. Everything is flushed at exit, within 1 s.
    """
    global _writer, _service
    shutdown()
    _service = service_id
    target = stream or sys.stderr
    _writer = QueueWriter(target.fileno(), service=service_id)
    _configure(_writer, readable=target.isatty(), service=service_id)
    logging.getLogger().handlers[:] = [_FromLibraries()]
    set_level(level)
    return _writer


def set_level(level: Level) -> None:
    """What is below ``level`` is not logged from here on, by no logger of this process, old or new."""
    global _least
    _least = logging.getLevelNamesMapping()[level.upper()]
    for handler in logging.getLogger().handlers:
        handler.setLevel(logging.WARNING if _least > logging.DEBUG else logging.INFO)
    logging.getLogger().setLevel(logging.WARNING if _least > logging.DEBUG else logging.INFO)


def level() -> Level:
    """What is logged now: this and above."""
    return cast("Level", logging.getLevelName(_least).lower())


def service() -> str | None:
    """Whose log this process writes; None before ``setup`` and after ``shutdown``."""
    return _service


def get(**bound: Any) -> FilteringBoundLogger:
    """A logger with ``bound`` in each of its events; valid before and after ``setup``."""
    return cast("FilteringBoundLogger", structlog.get_logger(**bound))


def dropped() -> int:
    """How many lines this process couldn't write."""
    return 0 if _writer is None else _writer.dropped


def shutdown(timeout_s: float = _FLUSH_S) -> None:
    """Write what is queued, for at most ``timeout_s``, and go back to plain stderr and level info; idempotent."""
    global _writer, _least, _service
    writer, _writer, _service = _writer, None, None
    if writer is not None:
        _least = logging.INFO
        _configure(None, readable=True)
        writer.close(timeout_s)


def _configure(writer: QueueWriter | None, *, readable: bool, service: str | None = None) -> None:
    renderer: Any = (
        structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty())
        if readable
        else structlog.processors.JSONRenderer(default=str)
    )

    def name_service(_logger: Any, _name: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
        # Not by contextvars: a thread starts without those of the thread that made it.
        if service is not None:
            event["service"] = service
        return event

    structlog.configure(
        processors=[
            _drop_below_level,
            name_service,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            _expected_without_traceback,
            *([] if readable else [structlog.processors.format_exc_info]),
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.DEBUG),
        logger_factory=lambda *_: _Sink(writer),
        cache_logger_on_first_use=False,
    )


def _drop_below_level(_logger: Any, name: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """A processor and not structlog's own filter: that is fixed for a logger once it has bound something."""
    if _NUMBERS.get(name, logging.ERROR) < _least:
        raise structlog.DropEvent
    return event


def _expected_without_traceback(_logger: Any, _name: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """An expected refusal is told by its code and sentence; only a bug keeps its traceback."""
    info = event.get("exc_info")
    error = sys.exc_info()[1] if info is True else info[1] if isinstance(info, tuple) else info
    if isinstance(error, TagmillError):
        del event["exc_info"]
        event["code"] = error.code
        event["reason"] = error.message
    return event


_configure(None, readable=True)
atexit.register(shutdown)
