"""A service's process and its workers have one thread for linear algebra, unless somebody asks for more."""

import os
import subprocess
import sys

NAMES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
SAY = "import os, sys; import services.label.__main__; print(*(os.environ[name] for name in sys.argv[1:]))"


def said(**given: str) -> list[str]:
    kept = {name: value for name, value in os.environ.items() if name not in NAMES}
    command = [sys.executable, "-c", SAY, *NAMES]
    return subprocess.run(command, env=kept | given, capture_output=True, text=True, check=True).stdout.split()


def test_one_thread_unless_asked() -> None:
    assert said() == ["1", "1"]
    assert said(OPENBLAS_NUM_THREADS="2") == ["2", "1"]
