"""Network cameras on loopback: an RTSP server in a process of its own, an MJPEG server in a thread."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import av
import cv2
import numpy as np

from tests.support.ports import free_port

WIDTH, HEIGHT, FPS = 160, 120, 25
SHADES = 8
DEADLINE_S = 20.0


def shade(number: int) -> int:
    """Grey of the n-th picture."""
    return 30 + 25 * (number % SHADES)


def picture(number: int) -> np.ndarray:
    return np.full((HEIGHT, WIDTH, 3), shade(number), np.uint8)


def number_in(bgr: np.ndarray) -> int:
    """Which picture it is, modulo SHADES."""
    return round((float(bgr.mean()) - 30) / 25)


def write_h264(path: Path, frames: int = 200) -> Path:
    """A video as network cameras send it."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=FPS)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.options = {"g": "5", "preset": "ultrafast", "tune": "zerolatency"}
        for number in range(frames):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture(number), "bgr24")))
        container.mux(stream.encode())
    return path


class RtspServer:
    """Serves the videos of ``folder`` at ``rtsp://127.0.0.1:port/``, in a loop."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.port = free_port()
        self._process: subprocess.Popen[bytes] | None = None
        self.start()

    def url(self, name: str, login: str = "") -> str:
        return f"rtsp://{login}127.0.0.1:{self.port}/{name}"

    def start(self) -> None:
        """Start it, or let it go on."""
        if self._process is not None:
            self._signal(signal.SIGCONT)
            return
        command = [str(Path(sys.executable).with_name("rtsp-server")), "-d", str(self._folder)]
        command += ["-H", "127.0.0.1", "-p", str(self.port), "-cp", str(free_port())]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + DEADLINE_S
        while True:
            with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
                return
            assert self._process.poll() is None, "the RTSP server has ended"
            assert time.monotonic() < deadline, "the RTSP server doesn't listen"
            threading.Event().wait(0.02)

    def hold(self) -> None:
        """It is still there, and sends nothing."""
        self._signal(signal.SIGSTOP)

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait(DEADLINE_S)
            self._process = None

    def _signal(self, number: int) -> None:
        assert self._process is not None
        os.kill(self._process.pid, number)


class MjpegServer:
    """``http://127.0.0.1:port/``: pictures as a plain camera sends them, ``/still`` one that never comes."""

    def __init__(self) -> None:
        self.flowing = threading.Event()
        self.flowing.set()
        self.sent = 0
        self._ending = threading.Event()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                outer.serve(self)

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = False
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,))
        self._thread.start()

    def url(self, path: str = "video", login: str = "") -> str:
        return f"http://{login}127.0.0.1:{self._server.server_port}/{path}"

    def serve(self, request: BaseHTTPRequestHandler) -> None:
        if request.path == "/private":
            request.send_error(401)
            return
        if request.path not in ("/video", "/text"):
            request.send_error(404)
            return
        request.send_response(200)
        if request.path == "/text":
            request.end_headers()
            request.wfile.write(b"no video at all")
            return
        request.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        request.end_headers()
        with suppress(OSError):
            while not self._ending.wait(1 / FPS):
                if not self.flowing.is_set():
                    continue
                jpeg = cv2.imencode(".jpg", picture(self.sent))[1].tobytes()
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                request.wfile.write(head.encode() + jpeg + b"\r\n")
                self.sent += 1

    def stop(self) -> None:
        self._ending.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(DEADLINE_S)


@contextmanager
def rtsp_server(folder: Path) -> Iterator[RtspServer]:
    made = RtspServer(folder)
    try:
        yield made
    finally:
        made.stop()


@contextmanager
def mjpeg_server() -> Iterator[MjpegServer]:
    made = MjpegServer()
    try:
        yield made
    finally:
        made.stop()
