"""Where the sockets are: one run folder a prefix, so that two stacks on a machine never meet."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from pathlib import Path

from common.config.models import NetworkConfig
from common.errors import ConfigError

DEFAULT_PREFIX = "tagmill"
MAX_PATH_BYTES = 107
"""Room for a path in a Unix socket address (108 bytes, the last is 0)."""

_LONGEST_NAME = "supervisor.sock.4194304"
"""supervisord binds its socket under a name that ends in its process id (22 bits at most), then renames it."""


@dataclass(frozen=True, slots=True)
class Endpoints:
    """The socket addresses of one stack.

    ``run_dir`` is the stack's own folder (run folder/prefix); ``command`` the command socket's address.
    """

    prefix: str
    run_dir: Path
    command: str

    @classmethod
    def of(cls, network: NetworkConfig) -> Endpoints:
        """The endpoints of a rig's ``network``; TAGMILL_PREFIX and TAGMILL_RUN_DIR win.

        Raises ConfigError if the run folder's path is too long for a Unix socket.
        """
        prefix = os.environ.get("TAGMILL_PREFIX") or network.prefix
        if "/" in prefix or prefix in {".", ".."}:
            raise ConfigError(f"prefix '{prefix}' would leave the run folder; use letters, digits, '-' and '_'")
        run_dir = default_run_folder() / prefix
        _check_length(run_dir)
        own = cls(prefix, run_dir, network.command)
        return own if prefix == DEFAULT_PREFIX else cls(prefix, run_dir, own.ipc("command"))

    def ipc(self, name: str) -> str:
        """The address of a socket ``name`` in the run folder."""
        return f"ipc://{self.run_dir / name}"

    def console_moves(self, network: NetworkConfig) -> bool:
        """Whether the console takes a free port: the address that is meant by default is the default stack's."""
        return self.prefix != DEFAULT_PREFIX and network.console == NetworkConfig().console

    @property
    def publish(self) -> str:
        """Where publishers connect (the proxy's XSUB)."""
        return self.ipc("publish")

    @property
    def subscribe(self) -> str:
        """Where subscribers connect (the proxy's XPUB)."""
        return self.ipc("subscribe")

    @property
    def publish_preview(self) -> str:
        """Where previews are published; a lane of its own, so that they can't crowd out anything."""
        return self.ipc("preview-publish")

    @property
    def subscribe_preview(self) -> str:
        """Where previews are subscribed to."""
        return self.ipc("preview-subscribe")

    @property
    def orders_store(self) -> str:
        """The store's order socket."""
        return self.ipc("orders-store")

    def orders_label(self, instance: int) -> str:
        """The order socket of label process ``instance``."""
        return self.ipc(f"orders-label.{instance}")

    def service_lock(self, service_id: str) -> Path:
        """The lock file that makes a service id unique on this machine."""
        return self.run_dir / f"{service_id}.lock"

    def prepare(self) -> None:
        """Make the run folder (mode 0700); raises ConfigError if it isn't ours alone or is no folder."""
        base = self.run_dir.parent
        for folder in (base, self.run_dir):
            _make_private(folder, strict=folder == self.run_dir or base == _fallback_run_folder())


def default_run_folder() -> Path:
    """TAGMILL_RUN_DIR, else ``$XDG_RUNTIME_DIR/tagmill``, else ``/tmp/tagmill-<uid>``."""
    named = os.environ.get("TAGMILL_RUN_DIR")
    if named:
        return Path(named).absolute()
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and Path(runtime).is_dir():
        return Path(runtime) / "tagmill"
    return _fallback_run_folder()


def check_tcp(address: str) -> None:
    """Raise ConfigError unless ``address`` is ``tcp://HOST:PORT``; ZeroMQ itself takes port 99999 for 34463."""
    transport, _, rest = address.partition("://")
    host, _, port = rest.rpartition(":")
    if transport != "tcp" or not host or not (port.isdecimal() and 0 < int(port) < 65536):
        raise ConfigError(
            f"network.command '{address}' is no address; use tcp://HOST:PORT with a port from 1 to 65535, "
            "e.g. tcp://127.0.0.1:5750"
        )


def ipc_path(address: str) -> Path:
    """The socket file of an ``ipc://`` address."""
    transport, _, rest = address.partition("://")
    if transport != "ipc":
        raise ValueError(f"{address} is no ipc address")
    return Path(rest)


def _fallback_run_folder() -> Path:
    return Path(f"/tmp/tagmill-{os.getuid()}")  # noqa: S108 - ownership and mode are checked in prepare()


def _check_length(run_dir: Path) -> None:
    longest = run_dir / _LONGEST_NAME
    size = len(os.fsencode(longest))
    if size > MAX_PATH_BYTES:
        raise ConfigError(
            f"the run folder {run_dir} is too long: its socket files would have {size} bytes and Unix allows "
            f"{MAX_PATH_BYTES}; set TAGMILL_RUN_DIR to a short path such as /tmp/tm, or shorten the prefix"
        )


def _make_private(folder: Path, *, strict: bool) -> None:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat() if strict else folder.stat()
    except FileExistsError as error:
        raise ConfigError(
            f"{folder} should be the run folder but is a file; move it away or set TAGMILL_RUN_DIR"
        ) from error
    except OSError as error:
        raise ConfigError(
            f"the run folder {folder} can't be made ({error.strerror}); set TAGMILL_RUN_DIR to a folder of yours"
        ) from error
    if not strict:
        return
    if not stat.S_ISDIR(found.st_mode):
        raise ConfigError(f"{folder} should be the run folder but is a link; set TAGMILL_RUN_DIR")
    if found.st_uid != os.getuid():
        raise ConfigError(
            f"the run folder {folder} belongs to user {found.st_uid}, not to {os.getuid()}; "
            "set TAGMILL_RUN_DIR to a folder of yours"
        )
    if found.st_mode & 0o077:
        folder.chmod(0o700)
