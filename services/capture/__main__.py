"""``python -m services.capture --rig rig.yaml --camera cam0``."""

import sys

from common.service import main
from services.capture.service import CaptureService

if __name__ == "__main__":
    sys.exit(main(CaptureService, "capture"))
