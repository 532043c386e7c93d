"""`python -m services.control --rig F`."""

import sys

from common import early_gc, early_signals, one_thread  # noqa: F401 - first: garbage, signals, threads
from common.service import main
from services.control.service import ControlService

sys.exit(main(ControlService, "control"))
