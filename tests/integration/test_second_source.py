"""The door for a model: a second, named source of detections reaches label file and ledger."""

from __future__ import annotations

import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.bus import CommandClient, Endpoints, Poller, Publisher, Subscriber
from common.config.models import NetworkConfig
from common.dataset import SessionReader
from common.labels import DetectedWindow, Window
from common.markers import family
from common.messages import Detections, FrameAnnounced
from common.topics import DETECTIONS, FRAME
from tests.support.stack import Stack, wait_for
from tools.stack.running import wait_ready

pytestmark = pytest.mark.process

RIG = """\
dataset: {root: ./dataset, session: door}
objects:
  - name: plate
    size_mm: {width: 200, height: 200, depth: 1}
    sides: {front: {marker: 7, marker_size_mm: 100, border_mm: 20}}
pose: {ambiguous: keep}
cameras:
  cam0: {driver: files, path: pictures, loop: true, begin: at_start, fps: 10}
ring: {samples: 8}
"""
SEEN = DetectedWindow(class_name="box", score=0.5, window=Window(x_min=1, y_min=2, x_max=30, y_max=40))


class Model:
    """Stands for a later process: sees each frame announced, publishes what it found under its own name."""

    def __init__(self) -> None:
        self._over = threading.Event()
        self.spoke = threading.Event()
        self._thread = threading.Thread(target=self._work)
        self._thread.start()

    def _work(self) -> None:
        endpoints = Endpoints.of(NetworkConfig())
        publisher = Publisher(endpoints, "model.boxes", "b00t")
        subscriber = Subscriber(endpoints)
        subscriber.subscribe(FRAME)
        poller = Poller(subscriber)
        while not self._over.is_set():
            poller.wait(0.1)
            for received in subscriber.receive():
                assert isinstance(received.message, FrameAnnounced)
                found = Detections(ref=received.message.ref, source="model.boxes", windows=(SEEN,))
                publisher.publish(DETECTIONS, (found.ref.camera, "model.boxes"), found)
                self.spoke.set()
        publisher.close()
        subscriber.close()

    def close(self) -> None:
        self._over.set()
        self._thread.join(5)


def test_a_models_detections_reach_label_and_ledger(stack: Stack, tmp_path: Path) -> None:
    (tmp_path / "pictures").mkdir()
    marker = family("apriltag_36h11", tmp_path).bitmap(7) * np.uint8(255)
    picture = np.full((480, 640, 3), 255, np.uint8)
    picture[120:320, 200:400] = cv2.resize(marker, (200, 200), interpolation=cv2.INTER_NEAREST)[..., None]
    cv2.imwrite(str(tmp_path / "pictures" / "a.png"), picture)
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG)
    for service in ("control", "store", "label", "detect"):
        stack.start_service(service, rig)
    stack.start_service("capture", rig, "--camera", "cam0")
    client = CommandClient(stack.endpoints, timeout_s=10)
    model = Model()
    try:
        wait_ready(client, ["cam0"])
        assert model.spoke.wait(30), "the model has seen a frame"
        started = client.request({"command": "start", "camera": "cam0", "until_count": 20})
        assert started["ok"], started

        def ended() -> bool:
            known = client.request({"command": "status"})["recordings"].get(started["recording"], {})
            return known.get("phase") == "ended"

        wait_for(ended, 30, "the recording to end")
        answer = client.request({"command": "ledger", "recording": started["recording"]})
    finally:
        model.close()
        client.close()
    session = SessionReader(tmp_path / "dataset" / "door")
    labels = [session.label(name) for name in session.samples()]
    assert len(labels) == 20
    assert {side.marker for label in labels for item in label.objects for side in item.sides} == {7}
    told = [label for label in labels if label.detections]
    assert told, "no label has the model's windows"
    assert {source.source for label in told for source in label.detections} == {"model.boxes"}
    assert all(source.windows == (SEEN,) for label in told for source in label.detections)
    detected = answer["ledger"]["cameras"]["cam0"]["detected"]
    assert detected["markers"] >= 20
    assert detected["model.boxes"] >= 1
