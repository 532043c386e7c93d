"""Where a session is worked on: by its stack, if one has it open, else in its folder under the session's lock."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from common.bus import CommandClient, Endpoints, holder_of
from common.config.dataset import DatasetConfig
from common.config.part import read_part
from common.dataset import SESSION_FILE
from common.dataset.bin import delete, restore, settle
from common.dataset.emptied import finish_removal, removed
from common.dataset.faults import explain
from common.dataset.listing import SampleIndex
from common.dataset.locks import FolderLock
from common.errors import RefusedError
from common.messages import MOST_LISTED, SampleFilter
from tools.commands.client import ask, connected, network_of

Plain = dict[str, Any]
T = TypeVar("T")

CONTROL = "control"
ASK_S = 35.0
UNKNOWN_SESSION = "unknown_session"


class InFolder:
    """A session's folder without a stack."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def move(self, command: str, samples: list[str]) -> Plain:
        """``delete`` or ``restore`` samples; the same answer as the command socket's. Raises RefusedError."""
        do = delete if command == "delete" else restore

        def move() -> Plain:
            do(self.folder, samples)
            return {"ok": True, "samples": list(dict.fromkeys(samples))}

        return self.locked(move)

    def page(self, wanted: SampleFilter, offset: int, limit: int) -> Plain:
        """List samples, as the command socket does; raises RefusedError."""
        index = SampleIndex(self.folder)
        _or_refused(self.folder, index.build)
        return {"ok": True, **index.page(wanted, offset, limit).model_dump(mode="json")}

    def locked(self, do: Callable[[], T]) -> T:
        """``do`` it while nobody else writes to the session, what a kill cut off before is finished first."""

        def locked() -> T:
            with FolderLock(self.folder):
                finish_removal(self.folder, removed(self.folder))
                settle(self.folder)
                return do()

        return _or_refused(self.folder, locked)


class OverSocket:
    """The session that a running stack has open."""

    def __init__(self, folder: Path, client: CommandClient) -> None:
        self.folder, self._client = folder, client

    def move(self, command: str, samples: list[str]) -> Plain:
        """As `InFolder.move`, at most 500 samples a request; what was moved before a refusal stays moved."""
        moved: list[str] = []
        for first in range(0, len(samples), MOST_LISTED):
            part = samples[first : first + MOST_LISTED]
            answer = ask(self._client, {"command": command, "samples": part}, ASK_S)
            moved += answer.get("samples", ())
            if not answer["ok"]:
                return {**answer, "samples": moved}
        return {"ok": True, "samples": moved}

    def page(self, wanted: SampleFilter, offset: int, limit: int) -> Plain:
        """As the command socket answers."""
        plain = wanted.model_dump(exclude_none=True)
        return ask(self._client, {"command": "samples", "filter": plain, "offset": offset, "limit": limit}, ASK_S)


def add_place(parser: argparse.ArgumentParser) -> None:
    """The arguments that say which session."""
    parser.add_argument(
        "--rig", type=Path, metavar="FILE", default=argparse.SUPPRESS, help="the rig file (default: ./rig.yaml)"
    )
    parser.add_argument(
        "--session", help="a session's name below dataset.root, or its folder (default: the stack's, else the rig's)"
    )


@contextmanager
def chosen(args: argparse.Namespace) -> Iterator[InFolder | OverSocket]:
    """The session that is meant; raises RefusedError ``unknown_session``, ConfigError, NoAnswerError."""
    network, _ = network_of(args.rig)
    if holder_of(Endpoints.of(network).service_lock(CONTROL)) is None:
        yield InFolder(named_session(args))
        return
    with connected(args) as client:
        status = ask(client, {"command": "status"})
        opened = Path(status["dataset"]) / status["session"]
        if args.session is None or _named(args).resolve() == opened.resolve():
            yield OverSocket(opened, client)
            return
    yield InFolder(named_session(args))


def named_session(args: argparse.Namespace) -> Path:
    """The folder of the session that ``--session`` or the rig file names; raises RefusedError, ConfigError."""
    return _existing(_named(args))


def _named(args: argparse.Namespace) -> Path:
    if args.session is not None and (Path(args.session) / SESSION_FILE).is_file():
        return Path(args.session)
    dataset, folder = _dataset_of(args.rig)
    return (folder / dataset.root).resolve() / (args.session or dataset.session)


def _dataset_of(rig: Path | None) -> tuple[DatasetConfig, Path]:
    """The rig file's ``dataset`` and the file's folder; the rest of the file may be wrong meanwhile."""
    if rig is None:
        return DatasetConfig(), Path()
    return read_part(rig, "dataset", DatasetConfig), rig.parent.absolute()


def _existing(folder: Path) -> Path:
    if not (folder / SESSION_FILE).is_file():
        raise RefusedError(f"there is no session {folder.name} in {folder.parent}", code=UNKNOWN_SESSION)
    return folder


def _or_refused(folder: Path, do: Callable[[], T]) -> T:
    try:
        return do()
    except OSError as error:
        told = explain(error, folder)
        raise RefusedError(told.message, code=told.code) from error
