"""``python -m services.capture --rig rig.yaml --camera cam0``."""

import sys

import common.first  # noqa: F401 - garbage, signals, threads: before all else
from common.service import main
from services.capture.service import CaptureService

if __name__ == "__main__":
    sys.exit(main(CaptureService, "capture"))
