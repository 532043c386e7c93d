"""``python -m services.capture --rig rig.yaml --camera cam0``."""

import sys

from common import early_signals  # noqa: F401 - holds signals from here on
from common.service import main
from services.capture.service import CaptureService

if __name__ == "__main__":
    sys.exit(main(CaptureService, "capture"))
