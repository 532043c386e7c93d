"""The console process: the operator's page, its pictures and its state; it can do nothing that the socket can't.

Consumes  SERVICE, CAMERA, RECORDING, SAMPLES; FRAME, LABELS, PREVIEW and the rings of cameras that somebody watches.
Produces  HTTP and one WebSocket a page at ``network.console``; commands to the command socket.
States    running.
"""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

from common.errors import ConfigError
from common.service import Context, Report
from services.console.config import console_address
from services.console.console import Console
from services.console.guard import is_loopback, new_token, rules_for
from services.console.server import Server, listen, server_for

TOKEN_FILE = "console.token"  # noqa: S105 - the file's name
_END_S = 5.0


class ConsoleService:
    """The event loop runs in slices of a round: in between, the runner beats the heart and hears signals."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._loop: asyncio.AbstractEventLoop | None = None
        self._console: Console | None = None
        self._server: Server | None = None
        self._serving: asyncio.Task[None] | None = None
        self._token_path: Path | None = None
        self.url = ""

    def open(self) -> None:
        """Bind the port, begin to listen to the bus; raises NameTakenError for a port in use."""
        context = self._context
        address = console_address(context.rig.config.network, context.endpoints)
        if address is None:
            raise ConfigError("network.console is null: there shall be no console, so don't start one")
        token = None if is_loopback(address.host) else self._token()
        listener = listen(address)
        try:
            port = listener.getsockname()[1]
            rules = rules_for(address.host, port, token)
            host = f"[{address.host}]" if ":" in address.host else address.host
            self.url = f"http://{host}:{port}"
            self._loop = asyncio.new_event_loop()
            self._loop.set_exception_handler(self._on_bug)
            self._console = Console(context, self._loop, rules)
            self._server = server_for(self._console.asgi)
            self._serving = self._loop.create_task(self._server.serve([listener]), name="http")
            self._console.start()
        except BaseException:
            listener.close()
            raise
        context.log.info("console.ready", url=self.url if token is None else f"{self.url}/?token={token}")

    def step(self, timeout_s: float) -> None:
        """Serve for a moment."""
        assert self._loop is not None
        self._loop.run_until_complete(asyncio.sleep(timeout_s))
        if self._console is not None:
            self._console.check()
        if self._serving is not None and self._serving.done():
            self._serving.result()
            raise RuntimeError("the HTTP server has ended by itself")

    def drain(self) -> bool:
        """A recording goes on without a page: nothing to finish."""
        return True

    def close(self) -> None:
        """Say good-bye to the pages, close the port, end the threads; idempotent."""
        loop, self._loop = self._loop, None
        if loop is None:
            return
        try:
            if self._console is not None:
                loop.run_until_complete(self._console.farewell())
            if self._server is not None and self._serving is not None and not self._serving.done():
                self._server.should_exit = True
                loop.run_until_complete(asyncio.wait({self._serving}, timeout=_END_S))
        finally:
            if self._console is not None:
                self._console.close()
            _end_tasks(loop)
            loop.close()
            if self._token_path is not None:
                self._token_path.unlink(missing_ok=True)

    def report(self) -> Report:
        """What the heartbeat says."""
        assert self._console is not None
        return self._console.report(self.url)

    def _token(self) -> str:
        """This stack's token: kept while the stack runs, so that a console that is restarted locks nobody out."""
        self._token_path = self._context.endpoints.run_dir / TOKEN_FILE
        try:
            kept = self._token_path.read_text(encoding="ascii").strip()
        except FileNotFoundError:
            kept = ""
        if kept:
            return kept
        token = new_token()
        with os.fdopen(os.open(self._token_path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
            file.write(token)
        return token

    def _on_bug(self, loop: asyncio.AbstractEventLoop, about: dict[str, object]) -> None:  # noqa: ARG002 - asyncio's
        """What nobody awaited: logged as the bug that it is."""
        self._context.log.error("console.bug", message=about.get("message"), exc_info=about.get("exception"))


def _end_tasks(loop: asyncio.AbstractEventLoop) -> None:
    tasks = asyncio.all_tasks(loop)
    for task in tasks:
        task.cancel()
    if tasks:
        loop.run_until_complete(asyncio.wait(tasks, timeout=_END_S))
    loop.run_until_complete(loop.shutdown_asyncgens())
