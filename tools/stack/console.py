"""Whether a stack has a console, and where."""

from __future__ import annotations

import importlib.util

from common.bus import Endpoints
from common.config.models import NetworkConfig

_NEEDS = ("fastapi", "uvicorn", "websockets", "prometheus_client")


def no_console(network: NetworkConfig) -> str | None:
    """Why there is no console, in one sentence; None if there is one."""
    if network.console is None:
        return "no console: network.console is null in the rig file"
    missing = [name for name in _NEEDS if importlib.util.find_spec(name) is None]
    if missing:
        return f"no console: {', '.join(missing)} not installed; pip install 'tagmill[console]', then start anew"
    return None


def console_place(network: NetworkConfig, endpoints: Endpoints) -> str:
    """Where the console will be, as far as it is known before it runs."""
    if endpoints.console_moves(network):
        return "console at a free port: `tagmill status` shows it"
    return f"console at {network.console}"
