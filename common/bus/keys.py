"""CURVE keys of the command socket: a folder with the server's pair, this machine's client pair, and who may in.

``server.key`` (public) goes to other machines along with a client pair made for each of them; the public key of
every client that is let in lies in ``authorized/``.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import zmq.auth

from common.errors import ConfigError, RefusedError

SERVER = "server"
CLIENT = "client"


@dataclass(frozen=True, slots=True)
class KeyPair:
    """A CURVE pair, Z85 text."""

    public: bytes
    secret: bytes


def create_keys(folder: Path) -> tuple[Path, ...]:
    """Make the server's and a first client's pair in ``folder`` (0700); returns the files made.

    Raises RefusedError ``keys_exist`` if there are keys already: new ones would lock everybody out.
    """
    if (folder / f"{SERVER}.key_secret").exists():
        raise RefusedError(f"{folder} has keys already; remove them first if they shall be replaced", code="keys_exist")
    _private_folder(folder)
    return (*_pair(folder, SERVER), *add_client(folder, CLIENT))


def add_client(folder: Path, name: str) -> tuple[Path, ...]:
    """Make a client's pair ``name`` and let it in; returns public file, secret file, entry in ``authorized``."""
    if not name.replace("-", "").replace("_", "").isalnum() or name == SERVER:
        raise ConfigError(f"'{name}' can't be a client's name; use letters, digits, '-' and '_'")
    if (folder / f"{name}.key_secret").exists():
        raise RefusedError(f"{folder} has a client '{name}' already", code="keys_exist")
    allowed = folder / "authorized"
    _private_folder(allowed)
    public, secret = _pair(folder, name)
    entry = allowed / public.name
    entry.write_bytes(public.read_bytes())
    return public, secret, entry


def server_pair(folder: Path) -> KeyPair:
    """The server's pair; raises ConfigError if it isn't there or others may read it."""
    return _load_secret(folder / f"{SERVER}.key_secret")


def client_pair(folder: Path, name: str = CLIENT) -> KeyPair:
    """A client's pair; raises ConfigError if it isn't there or others may read it."""
    return _load_secret(folder / f"{name}.key_secret")


def server_public(folder: Path) -> bytes:
    """The server's public key; raises ConfigError if it isn't there."""
    return _load(folder / f"{SERVER}.key")[0]


def authorized_keys(folder: Path) -> frozenset[bytes]:
    """The public keys of all that are let in; raises ConfigError if one can't be read."""
    allowed = folder / "authorized"
    try:
        paths = sorted(path for path in allowed.iterdir() if path.suffix == ".key")
    except (FileNotFoundError, NotADirectoryError):
        raise ConfigError(f"{allowed} is missing: nobody could reach the command socket; run 'tagmill keys'") from None
    except OSError as error:
        raise ConfigError(
            f"{allowed} can't be read ({error.strerror}): nobody could reach the command socket; it must belong to the "
            "user that tagmill runs as"
        ) from error
    return frozenset(_load(path)[0] for path in paths)


def _load_secret(path: Path) -> KeyPair:
    public, secret = _load(path)
    if secret is None:
        raise ConfigError(f"{path} holds no secret key; make keys with 'tagmill keys'")
    if path.stat().st_mode & 0o077:
        raise ConfigError(f"{path} can be read by others; run: chmod 600 {path}")
    return KeyPair(public, secret)


def _load(path: Path) -> tuple[bytes, bytes | None]:
    try:
        return zmq.auth.load_certificate(path)
    except (OSError, ValueError) as error:
        raise ConfigError(f"no usable key in {path} ({error}); make keys with 'tagmill keys'") from error


def _pair(folder: Path, name: str) -> tuple[Path, Path]:
    before = os.umask(0o077)
    try:
        public, secret = zmq.auth.create_certificates(folder, name)
    finally:
        os.umask(before)
    return Path(public), Path(secret)


def _private_folder(folder: Path) -> None:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.chmod(0o700)
    except OSError as error:
        raise ConfigError(f"the key folder {folder} can't be made: {error.strerror}") from error
