"""Crowds for `bench chaos`, in a process of their own: ``python -m tools.bench.chaos.crowd clients|viewers ...``."""

from __future__ import annotations

import json
import resource
import sys

from common.bus import CommandClient, Poller
from common.clock import monotonic_ns
from common.errors import TagmillError

_ANSWER_S = 20.0


def clients(address: str, count: int) -> dict[str, int]:
    """So many clients at once on the command socket; every other one leaves without reading its answer."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    crowd: list[CommandClient] = []
    asked = answered = 0
    try:
        for number in range(count):
            client = CommandClient(address)
            crowd.append(client)
            try:
                client.send({"command": "status" if number % 4 else "help"})
                asked += 1
            except TagmillError:
                continue
        deadline = monotonic_ns() + int(_ANSWER_S * 1e9)
        waiting = crowd[::2]
        poller = Poller()
        while waiting and monotonic_ns() < deadline:
            poller.wait(0.05)
            still = [client for client in waiting if not client.receive()]
            answered += len(waiting) - len(still)
            waiting = still
    finally:
        for client in crowd:
            client.close()
    return {"asked": asked, "answered": answered}


def viewers(url: str, camera: str, count: int, seconds: float, width: int) -> dict[str, int]:
    """So many pages that watch a camera."""
    from tools.bench.console_pages import Pages

    with Pages(url, camera, count, width) as pages:
        Poller().wait(seconds)
        return {"pictures": sum(pages.result().pictures)}


def main(words: list[str]) -> int:
    """Run one crowd and print what came of it."""
    match words:
        case ["clients", address, count]:
            print(json.dumps(clients(address, int(count))))
        case ["viewers", url, camera, count, seconds, width]:
            print(json.dumps(viewers(url, camera, int(count), float(seconds), int(width))))
        case _:
            print("crowd clients ADDRESS COUNT | crowd viewers URL CAMERA COUNT SECONDS WIDTH", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
