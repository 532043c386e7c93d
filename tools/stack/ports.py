"""Whether somebody else holds an address that a stack is about to bind."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator
from urllib.parse import urlsplit

from common.bus import Endpoints
from common.config.models import NetworkConfig
from common.errors import NameTakenError


def refuse_taken(network: NetworkConfig, endpoints: Endpoints, *, console: bool) -> None:
    """Raise NameTakenError if another program listens where the command socket or the console would.

    The services wait for such an address by themselves; whoever types `tagmill up` is told at once instead.
    ``console``: whether this stack has one.
    """
    for key, host, port in _wanted(network, endpoints, console=console):
        if _is_taken(host, port):
            raise NameTakenError(
                f"{host}:{port} is in use by another program; stop it, or choose another network.{key} in the rig file"
            )


def _wanted(network: NetworkConfig, endpoints: Endpoints, *, console: bool) -> Iterator[tuple[str, str, int]]:
    """Key of ``network``, host, port; an address that is none is the services' to refuse."""
    addresses = [("command", endpoints.command)]
    if console and network.console is not None and not endpoints.console_moves(network):
        addresses.append(("console", network.console))
    for key, address in addresses:
        parts = urlsplit(address)
        try:
            host, port = parts.hostname, parts.port
        except ValueError:
            continue
        if parts.scheme != "ipc" and host and port:
            yield key, host, port


def _is_taken(host: str, port: int) -> bool:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as made:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the services do: TIME_WAIT is no holder
        try:
            made.bind((host, port))
        except OSError as error:
            return error.errno == errno.EADDRINUSE
    return False
