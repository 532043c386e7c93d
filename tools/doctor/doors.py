"""Cameras and their libraries, and the addresses a stack would bind."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from common.bus import Endpoints
from common.bus.keys import authorized_keys, server_pair
from common.config import Rig, RigConfig
from common.config.models import NetworkConfig
from common.errors import ConfigError, NameTakenError
from services.capture.attached import Found, ask_drivers
from tools.doctor.finding import Finding, bad, good, warning
from tools.stack.console import no_console
from tools.stack.leftovers import living
from tools.stack.ports import refuse_taken

_ASK_S = 20.0
"""A library that hangs hangs for ever; on a busy machine a good one takes seconds to load."""


def cameras(rig: Rig | None) -> Iterator[Finding]:
    """Each driver's libraries, what is attached, and whether this user may open it."""
    used = {camera.driver for camera in rig.config.cameras.values()} if rig is not None else set()
    for found in ask_drivers(deadline_s=_ASK_S):
        about = f"driver {found.driver}"
        if found.problem is not None:
            yield (bad if found.driver in used else warning)(about, *_parted(found.problem))
            continue
        yield from (warning(about, *_parted(hint)) for hint in (*found.hints, *_notes(found)))
        if not found.hints:
            there = ", ".join(camera.name for camera in found.cameras)
            yield good(about, there or ("usable, none attached" if found.lists else "usable"))


def _notes(found: Found) -> list[str]:
    return [f"{camera.name} {camera.address}: {camera.note}" for camera in found.cameras if camera.note]


def _parted(sentence: str) -> tuple[str, str]:
    """What is wrong and what to do, of the drivers' sentences: the cure follows the last semicolon or colon."""
    for mark in ("; ", ": "):
        what, found, cure = sentence.rpartition(mark)
        if found:
            return what, cure
    return sentence, "see docs/how-to/cameras.md"


def ports(rig: Rig | None) -> Iterator[Finding]:
    """Whether the addresses are free, and guarded where others can reach them."""
    network = (rig.config if rig is not None else RigConfig()).network
    endpoints = Endpoints.of(network)
    if living(endpoints):
        yield good("addresses", "held by the stack that runs")
    else:
        try:
            refuse_taken(network, endpoints, console=no_console(network) is None)
            yield good("addresses", _free(network, endpoints))
        except NameTakenError as error:
            yield bad("addresses", *_parted(error.message))
    reason = no_console(network)
    if reason is not None and network.console is not None:
        yield warning("console", *_parted(reason.removeprefix("no console: ")))
    if rig is not None and network.keys is not None:
        yield _keys(rig.resolve(network.keys))


def _free(network: NetworkConfig, endpoints: Endpoints) -> str:
    if network.console is None:
        return f"{endpoints.command} is free; no console is wanted"
    if endpoints.console_moves(network):
        return f"{endpoints.command} is free; the console takes any free port"
    return f"{endpoints.command} and {network.console} are free"


def _keys(folder: Path) -> Finding:
    about, cure = "keys", "as it says; docs/how-to/secure-the-sockets.md has the whole story"
    try:
        server_pair(folder)
        count = len(authorized_keys(folder))
        return good(about, f"{count} client{'s' * (count != 1)} may use the command socket")
    except ConfigError as error:
        return bad(about, error.message, cure)
