"""uvicorn as a part of our process: our loop, our listening socket, our signals."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple, cast
from urllib.parse import urlsplit

import uvicorn

from common.errors import ConfigError, NameTakenError
from services.console.guard import Application

if TYPE_CHECKING:
    from uvicorn._types import ASGIApplication

MOST_MESSAGE_BYTES = 65536
"""Of what a page may send in one piece."""
_BACKLOG = 64
_GOOD_BYE_S = 2


class Address(NamedTuple):
    """Where the console listens; port 0 = any that is free."""

    host: str
    port: int


def address_of(url: str) -> Address:
    """The parts of ``network.console``; raises ConfigError for what is no such address."""
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    plain = parts.path in {"", "/"} and not parts.query and not parts.fragment and parts.username is None
    if parts.scheme != "http" or not parts.hostname or port is None or not plain:
        raise ConfigError(
            f"network.console '{url}' is no address; use http://HOST:PORT, e.g. http://127.0.0.1:8750, "
            "or null for no console"
        )
    return Address(parts.hostname, port)


def listen(address: Address) -> socket.socket:
    """A listening socket; raises NameTakenError if the port is in use, ConfigError if it can't be bound at all."""
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    made = socket.socket(family, socket.SOCK_STREAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((address.host, address.port))
        made.listen(_BACKLOG)
    except OSError as error:
        made.close()
        where = f"http://{address.host}:{address.port}"
        if error.errno == errno.EADDRINUSE:
            raise NameTakenError(
                f"{where} is in use by another program; stop it, or choose another network.console"
            ) from error
        raise ConfigError(f"network.console {where} can't be bound ({error.strerror})") from error
    made.setblocking(False)
    return made


class Server(uvicorn.Server):
    """Leaves the signals to our runner."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """uvicorn would take SIGTERM and SIGINT over."""
        yield


def server_for(app: Application) -> Server:
    """A server without a lifespan, logs of its own, or compression (which costs 35 times the sending of a JPEG)."""
    config = uvicorn.Config(
        cast("ASGIApplication", app),
        http="h11",
        ws="websockets-sansio",
        ws_max_size=MOST_MESSAGE_BYTES,
        ws_per_message_deflate=False,
        ws_ping_interval=None,  # the protocol's own ping says more: that the page still runs
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=_GOOD_BYE_S,
    )
    return Server(config)
