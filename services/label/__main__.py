"""``python -m services.label --rig F [--instance N]``."""

import sys

import common.first  # noqa: F401 - garbage, signals, threads: before all else
from common.service import main
from services.label.service import LabelService

if __name__ == "__main__":
    sys.exit(main(LabelService, "label"))
