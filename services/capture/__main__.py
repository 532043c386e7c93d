"""``python -m services.capture --rig rig.yaml --camera cam0``."""

import sys

from common import early_signals, one_thread  # noqa: F401 - hold signals and count threads from here on
from common.service import main
from services.capture.service import CaptureService

if __name__ == "__main__":
    sys.exit(main(CaptureService, "capture"))
