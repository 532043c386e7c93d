"""What an address of a socket says of who can reach it."""

from __future__ import annotations

import ipaddress


def is_local(address: str) -> bool:
    """Whether only this machine reaches ``address``: ipc, inproc, or tcp on a loopback address."""
    transport, _, rest = address.partition("://")
    if transport in {"ipc", "inproc"}:
        return True
    host = rest.rpartition(":")[0].strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
