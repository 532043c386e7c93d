"""``python -m services.store``."""

import sys

from common import early_gc, early_signals, one_thread  # noqa: F401 - first: garbage, signals, threads
from common.service import main
from services.store.service import StoreService

if __name__ == "__main__":  # the worker processes import this module
    sys.exit(main(StoreService, "store"))
