"""``python -m services.store``."""

import sys

import common.first  # noqa: F401 - garbage, signals, threads: before all else
from common.service import main
from services.store.service import StoreService

if __name__ == "__main__":  # the worker processes import this module
    sys.exit(main(StoreService, "store"))
