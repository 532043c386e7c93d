"""`python -m services.control --rig F`."""

import sys

from common.service import main
from services.control.service import ControlService

sys.exit(main(ControlService, "control"))
