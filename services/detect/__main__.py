"""``python -m services.detect --rig F [--instance N]``."""

import sys

from common import early_signals  # noqa: F401 - holds signals from here on
from common.service import main
from services.detect.service import DetectService

if __name__ == "__main__":
    sys.exit(main(DetectService, "detect"))
