"""Talking to a running supervisord over its Unix socket, every call with a deadline."""

from __future__ import annotations

import http.client
import os
import select
import socket
import xmlrpc.client
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.errors import EXIT_NO_ANSWER, TagmillError

CALL_S = 10.0
_SHUTDOWN_STATE = 6  # supervisor.xmlrpc.Faults.SHUTDOWN_STATE: it is going down already


class SupervisorError(TagmillError):
    """The supervisor gave no answer, or one that isn't any."""

    code = "no_supervisor"
    exit_code = EXIT_NO_ANSWER


@dataclass(frozen=True, slots=True)
class ProcessState:
    """A program as the supervisor sees it; ``state`` is its word, e.g. RUNNING (which is not yet *ready*)."""

    name: str
    state: str
    pid: int


class Supervisor:
    """The supervisord that listens at ``path``; raises SupervisorError where nobody answers."""

    def __init__(self, path: Path, timeout_s: float = CALL_S) -> None:
        self.path = path
        self._proxy = xmlrpc.client.ServerProxy("http://supervisor", transport=_UnixTransport(path, timeout_s))

    def pid(self) -> int:
        """The supervisord's own process id."""
        return int(self._call("supervisor.getPID"))

    def processes(self) -> tuple[ProcessState, ...]:
        """All programs."""
        answer = self._call("supervisor.getAllProcessInfo")
        return tuple(ProcessState(one["name"], one["statename"], int(one["pid"])) for one in answer)

    def shutdown(self) -> None:
        """Ask it to stop every program and to end; no difference if it is about to."""
        try:
            self._call("supervisor.shutdown")
        except xmlrpc.client.Fault as fault:
            if fault.faultCode != _SHUTDOWN_STATE:
                raise SupervisorError(f"the supervisor refused to shut down: {fault.faultString}") from fault

    def _call(self, method: str) -> Any:
        try:
            return getattr(self._proxy, method)()
        except (OSError, http.client.HTTPException, xmlrpc.client.ProtocolError) as error:
            raise SupervisorError(f"no supervisor answers at {self.path} ({error})") from error


class _UnixTransport(xmlrpc.client.Transport):
    """XML-RPC over a Unix socket, with a time limit (that of supervisor has none)."""

    def __init__(self, path: Path, timeout_s: float) -> None:
        super().__init__()
        self._path = path
        self._timeout_s = timeout_s

    def make_connection(self, host: Any) -> http.client.HTTPConnection:  # noqa: ARG002 - the base class's signature
        return _UnixConnection(self._path, self._timeout_s)


class _UnixConnection(http.client.HTTPConnection):
    def __init__(self, path: Path, timeout_s: float) -> None:
        super().__init__("localhost", timeout=timeout_s)
        self._path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        self.sock.connect(str(self._path))


@contextmanager
def watched(pid: int) -> Iterator[int | None]:
    """A descriptor that becomes readable when the process ends, None if there is no such process."""
    try:
        descriptor = os.pidfd_open(pid)
    except ProcessLookupError:
        yield None
        return
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def wait_for_end(descriptor: int | None, timeout_s: float) -> bool:
    """Wait for the process of ``watched`` to end; False if it still runs after ``timeout_s``."""
    return descriptor is None or bool(select.select([descriptor], [], [], timeout_s)[0])
