"""The very package of docs/how-to/add-a-camera.md, installed by pip, records through the real stack."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.dataset import SessionReader
from tests.support.rendered_marker import drawing
from tests.support.stack import ROOT, write_rig
from tests.support.supervised import DEADLINE_S, supervised

pytestmark = [pytest.mark.process, pytest.mark.timeout(300)]
PAGE = (ROOT / "docs" / "how-to" / "add-a-camera.md").read_text()
ADDRESS = "http://192.0.2.7/snapshot.jpg"
OBJECT = """\
dataset: {root: ./dataset, session: test}
objects:
  - name: plate
    size_mm: {width: 200, height: 200, depth: 1}
    sides: {front: {marker: 0, marker_size_mm: 100, border_mm: 20}}
pose: {ambiguous: keep}
ring: {slots: 4}
"""


def example(language: str) -> str:
    """The page's one block of a language."""
    (found,) = re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    return str(found)


def picture() -> bytes:
    """An upright marker 0 on white paper, as the camera's JPEG."""
    page = np.full((480, 640), 230, np.uint8)
    marker = cv2.resize(drawing("DICT_APRILTAG_36h11", 0) * 255, (240, 240), interpolation=cv2.INTER_NEAREST)
    page[120:360, 200:440] = marker
    return cv2.imencode(".jpg", page)[1].tobytes()


@contextmanager
def served(data: bytes) -> Iterator[str]:
    """A network camera on loopback; its address."""

    class Snapshot(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, *words: object) -> None:
            """Quiet."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Snapshot)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/snapshot.jpg"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def test_the_example_is_short() -> None:
    assert len([line for line in example("python").splitlines() if line.strip()]) < 40


def test_the_example_package_is_installed_and_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package, site = tmp_path / "tagmill-snapshot", tmp_path / "site"
    package.mkdir()
    (package / "pyproject.toml").write_text(example("toml"))
    (package / "snapshot_camera.py").write_text(example("python"))
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(site), str(package)], check=True, timeout=120)
    monkeypatch.setenv("PYTHONPATH", str(site))
    with served(picture()) as address:
        cameras = example("yaml")
        assert ADDRESS in cameras
        rig = write_rig(tmp_path, OBJECT + cameras.replace(ADDRESS, address))
        with supervised(rig, "door") as stack:
            answer = stack.ask(command="record", camera="door", timeout_s=DEADLINE_S)
            assert answer["ok"], answer
            assert stack.status()["cameras"]["door"]["driver"] == "snapshot"
    reader = SessionReader(tmp_path / "dataset" / "test")
    (label,) = [reader.label(sample) for sample in answer["samples"]]
    assert (label.camera.name, label.camera.width, label.camera.height) == ("door", 640, 480)
    assert [one.name for one in label.objects] == ["plate"]
