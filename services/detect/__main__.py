"""``python -m services.detect --rig F [--instance N]``."""

import sys

import common.first  # noqa: F401 - garbage, signals, threads: before all else
from common.service import main
from services.detect.service import DetectService

if __name__ == "__main__":
    sys.exit(main(DetectService, "detect"))
