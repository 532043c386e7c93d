"""`python -m services.control --rig F`."""

import sys

from common import early_signals, one_thread  # noqa: F401 - hold signals and count threads from here on
from common.service import main
from services.control.service import ControlService

sys.exit(main(ControlService, "control"))
