"""Where the console shall be."""

from __future__ import annotations

from common.bus import Endpoints
from common.config.models import NetworkConfig
from services.console.server import Address, address_of


def console_address(network: NetworkConfig, endpoints: Endpoints) -> Address | None:
    """``network.console``, None where there shall be none.

    A stack with another prefix takes a free port instead of the default one, so that two stacks never meet.
    """
    if network.console is None:
        return None
    address = address_of(network.console)
    return Address(address.host, 0) if endpoints.console_moves(network) else address
