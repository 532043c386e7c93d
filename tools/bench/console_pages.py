"""Pages for `tagmill bench console`: clients of the console's WebSocket, one thread each."""

from __future__ import annotations

import json
import struct
import threading
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import cv2
import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from common.clock import monotonic_ns
from common.scene.burnt import read_number
from common.service.meters import Percentiles

_RECEIVE_S = 0.5
_PING_NS = 5_000_000_000


@dataclass(frozen=True)
class Seen:
    """Pictures by page; of the first page also latencies, and how many pictures were not those of their header."""

    pictures: list[int]
    p50_ms: float | None
    p99_ms: float | None
    wrong_pixels: int


class Pages:
    """So many pages that watch one camera, for the length of a block."""

    def __init__(self, url: str, camera: str, count: int, width: int) -> None:
        self._url, self._camera, self._width = url, camera, width
        self._over = threading.Event()
        self._pictures = [0] * count
        self._latency_ns = Percentiles(100_000)
        self._wrong = 0
        self._threads = [
            threading.Thread(target=self._look, args=(page,), name=f"page-{page}") for page in range(count)
        ]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join(10)

    def reset(self) -> None:
        """Count from here on."""
        self._pictures = [0] * len(self._pictures)
        self._latency_ns = Percentiles(100_000)
        self._wrong = 0

    def result(self) -> Seen:
        """What was seen since ``reset``."""
        known = len(self._latency_ns) > 0
        p50, p99 = (round(self._latency_ns.at(percent) / 1e6, 1) if known else None for percent in (50, 99))
        return Seen(list(self._pictures), p50, p99, self._wrong)

    def _look(self, page: int) -> None:
        address = self._url.replace("http://", "ws://") + "/ws"
        with connect(address, origin=Origin(self._url), max_size=None, compression=None) as connection:
            view = {"id": "live", "camera": self._camera, "kind": "rgb", "width": self._width}
            connection.send('{"t":"hello","v":1}')
            connection.send(json.dumps({"t": "watch", "views": [view], "visible": True}))
            pinged_ns = monotonic_ns()
            while not self._over.is_set():
                if monotonic_ns() - pinged_ns > _PING_NS:
                    pinged_ns = monotonic_ns()
                    connection.send('{"t":"ping"}')
                try:
                    message = connection.recv(timeout=_RECEIVE_S)
                except TimeoutError:
                    continue
                except ConnectionClosed:
                    return
                if isinstance(message, bytes):
                    self._draw(page, connection, message)

    def _draw(self, page: int, connection: ClientConnection, message: bytes) -> None:
        (length,) = struct.unpack_from("<I", message)
        header = json.loads(message[4 : 4 + length])
        if page == 0:
            picture = cv2.imdecode(np.frombuffer(message, np.uint8, offset=4 + length), cv2.IMREAD_COLOR)
            now = monotonic_ns()
            shown = None if picture is None else read_number(np.asarray(picture, np.uint8))
            self._wrong += shown != header["frame"] - 1  # the driver counts from 0, the ring from 1
            self._latency_ns.add(now - header["captured_ns"])
        connection.send(json.dumps({"t": "ack", "id": header["id"], "seq": header["seq"]}))
        self._pictures[page] += 1
