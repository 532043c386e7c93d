"""The guided calibration behind the page: `tagmill calibrate --events` as a niced process, its words as state.

The same program as in a terminal looks for the board, guides, judges and writes; the console starts it, passes the
operator's orders on and shows what it says (docs/decisions/0012). It ends by itself when it is done, when no page has
looked at it for a while, and when the console is gone; what was taken is kept in any case.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal

from structlog.typing import FilteringBoundLogger

from common import clock
from common.errors import RefusedError
from services.console.line import Plain

Phase = Literal["idle", "starting", "guiding", "finishing", "stopping", "ended"]
Order = Literal["take", "drop", "finish"]
LOOK_NS = 60_000_000_000
"""A calibration that no page has looked at for so long is ended."""
NICE = 12
"""Cameras, detection and labelling come before it."""
_LONGEST_LINE = 8 * 1024 * 1024
_END_S = 8.0
_SAID = 2000
_ONE_THREAD = dict.fromkeys(("OPENCV_FOR_THREADS_NUM", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


class Calibrator:
    """At most one calibration at a time; what it is and what it left is told by ``data``."""

    def __init__(self, log: FilteringBoundLogger) -> None:
        self.phase: Phase = "idle"
        self.report: Path | None = None
        self._log = log
        self._process: asyncio.subprocess.Process | None = None
        self._running: asyncio.Task[None] | None = None
        self._looked_ns = 0
        self._told: Plain = {}
        self._result: Plain = {}

    @property
    def busy(self) -> bool:
        """Whether one runs."""
        return self._running is not None and not self._running.done()

    async def start(self, camera: str, words: Sequence[str]) -> None:
        """Begin: ``words`` are the arguments of `tagmill calibrate`. Raises RefusedError while another one runs."""
        if self.busy:
            raise RefusedError(f"{self._told['camera']} is being calibrated already; end that first", code="busy")
        self._told = {"camera": camera, "guidance": None, "progress": None, "result": None}
        self._result = {}
        self.report = None
        self.look()
        self.phase = "starting"
        command = [sys.executable, "-m", "tools", "calibrate", "--events", "--camera", camera, *words]
        pipe = asyncio.subprocess.PIPE
        self._process = await asyncio.create_subprocess_exec(
            *command,
            stdin=pipe,
            stdout=pipe,
            stderr=pipe,
            limit=_LONGEST_LINE,
            env={**os.environ, **_ONE_THREAD},
            start_new_session=True,  # a terminal's Ctrl-C is the stack's; this one ends with the console
        )
        os.setpriority(os.PRIO_PROCESS, self._process.pid, NICE)
        self._log.info("calibration.started", camera=camera, pid=self._process.pid)
        self._running = asyncio.create_task(self._follow(self._process), name="calibration")

    async def order(self, order: Order) -> None:
        """Pass an order on. Raises RefusedError while no board is being shown to it."""
        if self.phase != "guiding" or self._process is None or self._process.stdin is None:
            raise RefusedError("no calibration is taking views at present", code="no_calibration")
        self.look()
        if order == "finish":
            self.phase = "finishing"
        with suppress(ConnectionError):  # it has just ended by itself
            self._process.stdin.write(f"{order}\n".encode())
            await self._process.stdin.drain()

    def stop(self) -> None:
        """End it as Ctrl-C does; the views are kept. Nothing happens where none runs."""
        if self.busy and self.phase != "stopping" and self._process is not None:
            self.phase = "stopping"
            with suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGINT)

    def look(self) -> None:
        """A page shows it."""
        self._looked_ns = clock.monotonic_ns()

    def check(self, now_ns: int) -> None:
        """End it if nobody has looked for long; raise a mistake of this module's own."""
        if self._running is not None and self._running.done() and not self._running.cancelled():
            self._running.result()
        if self.busy and now_ns - self._looked_ns > LOOK_NS and self.phase == "guiding":
            self._log.info("calibration.unwatched", camera=self._told["camera"])
            self.stop()

    def data(self) -> Plain:
        """The topic ``calibration``."""
        return {"phase": self.phase, **self._told}

    async def close(self) -> None:
        """End it, by force in the end; idempotent."""
        if self._running is None or self._process is None:
            return
        self.stop()
        _, late = await asyncio.wait({self._running}, timeout=_END_S)
        if late:
            with suppress(ProcessLookupError):
                self._process.kill()
            await asyncio.wait({self._running}, timeout=_END_S)

    # --- what it says -------------------------------------------------------------------------------------

    async def _follow(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdout is not None
        assert process.stderr is not None
        complaints = asyncio.create_task(process.stderr.read(), name="calibration-stderr")
        try:
            async for line in process.stdout:
                self._hear(line)
            code = await process.wait()
            said = (await complaints)[-_SAID:].decode(errors="replace").strip()
        finally:
            complaints.cancel()
            if process.stdin is not None:
                process.stdin.close()
        self._ended(code, said)

    def _hear(self, line: bytes) -> None:
        try:
            document: Plain = json.loads(line)
        except ValueError:
            self._log.warning("calibration.not_understood", said=line[:_SAID].decode(errors="replace"))
            return
        match document.pop("event", None):
            case "guidance":
                self._told["guidance"] = document
                if self.phase == "starting":
                    self.phase = "guiding"
            case "progress":
                self._told["progress"] = document
                if self.phase != "stopping":
                    self.phase = "finishing"
            case _:
                self._result = document

    def _ended(self, code: int, said: str) -> None:
        found = self._result
        self.phase = "ended"
        self._told["progress"] = None
        self._log.info("calibration.ended", camera=self._told["camera"], exit_code=code, verdict=found.get("verdict"))
        if "verdict" in found:
            self.report = Path(found["report"])
            self._told["result"] = in_short(found)
            return
        error = found.get("error") or {"code": "failed", "message": "the calibration ended without a word"}
        if error["code"] == "failed":
            self._log.error("calibration.failed", exit_code=code, said=said)
        elif error["code"] == "interrupted":
            error = {"code": "interrupted", "message": "ended; what was taken is kept"}
        self._told["result"] = {"verdict": None, "error": error}


def in_short(found: Plain) -> Plain:
    """Of what `tagmill calibrate --json` says, what a page shows."""
    quality = found.get("quality") or {}
    return {
        "verdict": found["verdict"],
        "sentence": found["sentence"],
        "reasons": [reason["words"] for reason in found["reasons"]],
        "file": None if found.get("file") is None else Path(found["file"]).name,
        "views": quality.get("views"),
        "focal_percent": quality.get("focal_percent"),
        "rms_px": quality.get("rms_px"),
        "held_out_px": quality.get("held_out_px"),
        "covered_percent": quality.get("covered_percent"),
        "left_out": [f"{item['name']}: {item['reason']}" for item in found["dropped"]],
        "notes": found["notes"],
        "error": None,
    }
