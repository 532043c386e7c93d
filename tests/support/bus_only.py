"""The bus proxy as a service of its own, for tests: ``python -m tests.support.bus_only --rig F``."""

from __future__ import annotations

import sys

from common.bus import Poller, Proxy
from common.service import Context, Report, main


class BusOnly:
    """Holds the proxy; does nothing else."""

    def __init__(self, context: Context) -> None:
        self._proxy = Proxy(context.endpoints, context.id)
        self._poller = Poller()

    def open(self) -> None:
        self._proxy.start()

    def step(self, timeout_s: float) -> None:
        self._poller.wait(timeout_s)

    def drain(self) -> bool:
        return True

    def close(self) -> None:
        self._proxy.close()

    def report(self) -> Report:
        return Report()


if __name__ == "__main__":
    sys.exit(main(BusOnly, "proxy"))
