"""What the sub-commands share: where the stack is, one request to it, its refusals on a screen."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from common.bus import CommandClient, Endpoints
from common.config.models import NetworkConfig
from common.config.part import read_part
from common.errors import EXIT_BAD_CONFIG, EXIT_OK, EXIT_REFUSED, ConfigError, NoAnswerError, TagmillError
from tools.cli import show_error
from tools.stack.silence import why_silent

ANSWER_S = 5.0
"""For commands that control answers without asking anybody."""
AFTER_S = 5.0
"""Control gives an answer at the command's own limit and a little later; the client waits so much longer."""
NOT_UP = "is the stack up? start it with 'tagmill up --rig rig.yaml'"


@contextmanager
def connected(args: argparse.Namespace) -> Iterator[CommandClient]:
    """A client of the stack that ``--rig`` names, else of the default one."""
    network, folder = network_of(args.rig)
    keys = folder / network.keys if network.keys is not None else None
    client = CommandClient(Endpoints.of(network), ANSWER_S, keys)
    try:
        yield client
    finally:
        client.close()


def network_of(rig: Path | None) -> tuple[NetworkConfig, Path]:
    """The rig file's ``network`` and the file's folder.

    Nothing else of the file is looked at: whoever wants to stop a recording must not be kept from it by a mistake
    in an object that is being edited. Raises ConfigError if even that part can't be read.
    """
    if rig is None:
        return NetworkConfig(), Path()
    return read_part(rig, "network", NetworkConfig), rig.parent.absolute()


def ask(client: CommandClient, request: dict[str, Any], timeout_s: float = ANSWER_S) -> dict[str, Any]:
    """One request, one answer (a refusal is an answer too); raises NoAnswerError with the cure."""
    present = {key: value for key, value in request.items() if value is not None}
    try:
        return client.request(present, timeout_s)
    except NoAnswerError as error:
        raise NoAnswerError(f"no tagmill answers at {client.address}: {_cure(client)}") from error


def _cure(client: CommandClient) -> str:
    """What keeps control from answering, as far as its supervisor and its log tell."""
    if client.run_dir is None:
        return NOT_UP
    return why_silent(client.run_dir) or NOT_UP


def finish(args: argparse.Namespace, answer: dict[str, Any]) -> int:
    """The end of a sub-command: JSON if wanted, a refusal in words; returns the exit code."""
    if args.json:
        print(json.dumps(answer))
    elif not answer["ok"]:
        error = answer["error"]
        if error["code"] == "bad_config":
            show_error(ConfigError(error["message"], tuple(answer.get("problems", ()))), as_json=False)
        else:
            show_error(TagmillError(error["message"], code=error["code"]), as_json=False)
    if answer["ok"]:
        return EXIT_OK
    return EXIT_BAD_CONFIG if answer["error"]["code"] == "bad_config" else EXIT_REFUSED
