"""``python -m services.console --rig F``."""

import sys

from common import early_signals  # noqa: F401 - holds signals from here on
from common.service import main
from services.console.service import ConsoleService

if __name__ == "__main__":
    sys.exit(main(ConsoleService, "console"))
