"""``python -m services.detect --rig F [--instance N]``."""

import sys

from common import early_gc, early_signals, one_thread  # noqa: F401 - first: garbage, signals, threads
from common.service import main
from services.detect.service import DetectService

if __name__ == "__main__":
    sys.exit(main(DetectService, "detect"))
