"""``python -m services.capture --rig rig.yaml --camera cam0``."""

import sys

from common import early_gc, early_signals, one_thread  # noqa: F401 - first: garbage, signals, threads
from common.service import main
from services.capture.service import CaptureService

if __name__ == "__main__":
    sys.exit(main(CaptureService, "capture"))
