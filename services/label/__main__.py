"""``python -m services.label --rig F [--instance N]``."""

import sys

from common import early_signals, one_thread  # noqa: F401 - hold signals and count threads from here on
from common.service import main
from services.label.service import LabelService

if __name__ == "__main__":
    sys.exit(main(LabelService, "label"))
