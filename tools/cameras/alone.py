"""One camera without a stack: its real capture process, started for a command and ended with it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from common.bus import Endpoints, Proxy
from common.config import Rig
from common.errors import CameraError, ConfigError
from common.ids import new_boot

STOP_S = 10.0


@contextmanager
def alone(rig: Rig, name: str, *, holder: str) -> Iterator[tuple[Endpoints, subprocess.Popen[bytes]]]:
    """The real capture process of one camera under a prefix of its own, with nothing but a bus around it.

    ``holder`` names the command that wants it. Raises CameraError or ConfigError, with the process's own words, if it
    ended by itself meanwhile.
    """
    prefix = f"tagmill-test-{new_boot()}"
    with tempfile.TemporaryDirectory(prefix="tagmill-") as folder:
        own = Endpoints(prefix, Path(folder) / prefix, "")
        proxy = Proxy(own, holder=holder)
        proxy.start()
        environment = {**os.environ, "TAGMILL_PREFIX": prefix, "TAGMILL_RUN_DIR": folder}
        command = [sys.executable, "-m", "services.capture", "--rig", str(rig.path), "--camera", name]
        log = Path(folder) / "capture.log"
        try:
            with log.open("wb") as sink:
                process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=sink,
                    stderr=subprocess.STDOUT,
                    env=environment,
                    start_new_session=True,  # Ctrl-C is this command's to answer, which then ends the process
                )
            try:
                yield own, process
                _check_end(process, log)
            finally:
                _end(process)
        finally:
            proxy.close()


def _check_end(process: subprocess.Popen[bytes], log: Path) -> None:
    """A process that has ended by itself says why on its last lines."""
    code = process.poll()
    if code is None:
        return
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    plain = [line for line in lines if not line.startswith("{")] or lines
    if code == ConfigError.exit_code:
        raise ConfigError("the camera can't be used as the rig file says", tuple(plain[1:] or plain))
    raise CameraError(f"the camera's process ended (exit code {code}): {plain[-1] if plain else 'it said nothing'}")


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
