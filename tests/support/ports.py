"""A TCP port for a server that a test starts a moment later."""

from __future__ import annotations

import random
import socket

_BELOW_EPHEMERAL = range(15_000, 32_000)
"""The kernel gives none of these to whoever asks for any port, so that nobody takes it in between."""


def free_port(host: str = "127.0.0.1") -> int:
    """One that nobody listens at."""
    while True:
        port = random.SystemRandom().choice(_BELOW_EPHEMERAL)
        try:
            with socket.create_server((host, port)):
                return port
        except OSError:
            continue
