"""`python -m services.control --rig F`."""

import sys

import common.first  # noqa: F401 - garbage, signals, threads: before all else
from common.service import main
from services.control.service import ControlService

sys.exit(main(ControlService, "control"))
