"""`python -m services.control --rig F`."""

import sys

from common import early_signals  # noqa: F401 - holds signals from here on
from common.service import main
from services.control.service import ControlService

sys.exit(main(ControlService, "control"))
