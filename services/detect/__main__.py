"""``python -m services.detect --rig F [--instance N]``."""

import sys

from common.service import main
from services.detect.service import DetectService

if __name__ == "__main__":
    sys.exit(main(DetectService, "detect"))
