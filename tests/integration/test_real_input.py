"""The whole stack under supervisord on real pictures and a real video, recorded from first to last frame."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from common.bus import CommandClient, Endpoints, Poller
from common.config import load_rig
from common.dataset import SessionReader
from tests.support.april_tags import april_tags
from tests.support.stack import wait_for
from tools.stack.running import running_stack, wait_ready

pytestmark = [pytest.mark.process, pytest.mark.timeout(300)]
Find = Callable[[str], Path]

TAGS = """\
dataset: {{root: ./dataset, session: real}}
markers: {{family: apriltag_36h11}}
objects:
  - name: tag-3
    size_mm: {{width: 200, height: 200, depth: 1}}
    sides: {{front: {{marker: 3, marker_size_mm: 165.1, border_mm: 15}}}}
  - name: tag-4
    size_mm: {{width: 200, height: 200, depth: 1}}
    sides: {{front: {{marker: 4, marker_size_mm: 165.1, border_mm: 15}}}}
network: {{console: null}}
cameras:
  cam0: {{driver: files, path: {video}, pace: consumer, calibration: camera.yaml}}
"""
CAMERA = {
    "width": 1920,
    "height": 1080,
    "camera_matrix": [[2142.5, 0, 993.7], [0, 2142.7, 543.0], [0, 0, 1]],
    "distortion": [0.514, -6.091, 0.001, 0.001, 19.87],
}


@contextmanager
def stack_of(rig: Path, *cameras: str) -> Iterator[CommandClient]:
    endpoints = Endpoints.of(load_rig(rig).config.network)
    with running_stack(rig, rig.parent / "stack.log"):
        client = CommandClient(endpoints, timeout_s=10)
        try:
            wait_ready(client, cameras)
            yield client
        finally:
            client.close()


def record_to_the_end(client: CommandClient, camera: str, deadline_s: float) -> dict[str, Any]:
    """`start`, wait until the recording has ended by itself, and the camera's account in the ledger."""
    started = client.request({"command": "start", "camera": camera})
    assert started["ok"], started
    pause = Poller()

    def ended() -> dict[str, Any] | None:
        pause.wait(0.3)
        recording = client.request({"command": "status"})["recordings"].get(started["recording"])
        return recording if recording and recording["phase"] == "ended" else None

    wait_for(ended, deadline_s, f"the recording on {camera} to end")
    answer = client.request({"command": "ledger", "recording": started["recording"]})
    assert answer["ok"], answer
    status = client.request({"command": "status"})
    assert status["cameras"][camera]["phase"] == "ended"
    (ledger,) = [answer["ledger"]] if "ledger" in answer else answer["ledgers"]
    account: dict[str, Any] = ledger["cameras"][camera]
    return account


@pytest.fixture
def two_tags(testdata: Find, tmp_path: Path, request: pytest.FixtureRequest) -> tuple[Path, int]:
    """The video with its number of frames, or every n-th frame as pictures in a folder (n is the parameter)."""
    video, step = testdata("wpical/two_tags.mp4"), request.param
    if step == 1:
        return video, 159
    folder = tmp_path / "frames"
    folder.mkdir()
    capture = cv2.VideoCapture(str(video))
    numbers = range(0, 159, step)
    for number in range(159):
        good, picture = capture.read()
        assert good
        if number in numbers:
            cv2.imwrite(str(folder / f"{number:03}.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    capture.release()
    return folder, len(numbers)


@pytest.mark.parametrize("two_tags", [12, pytest.param(1, marks=pytest.mark.long)], indirect=True)
def test_two_tags_from_first_to_last_frame(two_tags: tuple[Path, int], tmp_path: Path) -> None:
    path, frames = two_tags
    rig = tmp_path / "rig.yaml"
    rig.write_text(TAGS.format(video=path))
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(CAMERA))
    with stack_of(rig, "cam0") as client:
        account = record_to_the_end(client, "cam0", 200)
    assert account["captured"] == frames
    settled = account["recorded"] + sum(account["refused"].values()) + sum(account["dropped"].values())
    assert settled == frames
    session = SessionReader(tmp_path / "dataset" / "real")
    samples = session.samples()
    assert len(samples) == account["recorded"] >= 0.94 * frames
    distances, kinds = [], set()
    for name in samples:
        label = session.label(name)
        centre = {item.name: np.array(item.pose.tvec_mm) for item in label.objects}
        kinds |= {side.corners_kind for item in label.objects for side in item.sides}
        if len(centre) == 2:
            distances.append(float(np.linalg.norm(centre["tag-3"] - centre["tag-4"])))
    assert len(distances) >= 0.94 * frames
    assert np.std(distances) < 3.0
    assert kinds == {"photometric"}
    stored = [cv2.cvtColor(session.colour(name), cv2.COLOR_BGR2GRAY) for name in samples]
    assert april_tags(stored) == [[]] * len(stored)
    session.verify(samples[0])


PHOTOS = {
    "duckietown": (("duckietown/",), "apriltag_36h11", 65.0),
    "ubiquity": (("ubiquity/",), "DICT_5X5_1000", 145.0),
    "predefined": (("opencv/singlemarkersoriginal.jpg", "opencv/choriginal.jpg"), "DICT_6X6_250", 50.0),
    "dictionary file": (("opencv/gboriginal.png", "opencv/diamondmarkers.png"), "opencv/tutorial_dict.yml", 40.0),
}
"""Pictures by the beginnings of their names, the family of their markers, the markers' size."""


@pytest.mark.parametrize(
    "what",
    [
        "duckietown",
        *(pytest.param(name, marks=pytest.mark.long) for name in ("predefined", "ubiquity", "dictionary file")),
    ],
)
def test_every_true_id_of_the_photos_is_labelled_or_listed_with_a_reason(
    what: str, testdata: Find, tmp_path: Path
) -> None:
    beginnings, family, size = PHOTOS[what]
    truth = {
        name: entry
        for name, entry in json.loads(testdata("truth.json").read_text()).items()
        if name.startswith(beginnings) and Path(name).suffix in {".jpg", ".png"}
    }
    assert truth
    ids = sorted({marker["id"] for entry in truth.values() for marker in entry["markers"]})
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for name in truth:
        (pictures / Path(name).name).symlink_to(testdata(name))
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        yaml.safe_dump(
            {
                "dataset": {"root": "./dataset", "session": "photos"},
                "markers": {"family": str(testdata(family)) if "/" in family else family},
                "pose": {"ambiguous": "keep"},
                "network": {"console": None},
                "objects": [
                    {
                        "name": f"marker-{number}",
                        "size_mm": {"width": 2 * size, "height": 2 * size, "depth": 1},
                        "sides": {"front": {"marker": number, "marker_size_mm": size, "border_mm": size / 8}},
                    }
                    for number in ids
                ],
                "cameras": {"cam0": {"driver": "files", "path": "pictures", "pace": "consumer", "fps": 5}},
            }
        )
    )
    with stack_of(rig, "cam0") as client:
        account = record_to_the_end(client, "cam0", 120)
    assert account["captured"] == len(truth)
    session = SessionReader(tmp_path / "dataset" / "photos")
    labels = {session.label(name).source_name: session.label(name) for name in session.samples()}
    assert len(labels) == account["recorded"] == len(truth), account
    for name, entry in truth.items():
        label = labels[Path(name).name]
        labelled = {side.marker for item in label.objects for side in item.sides}
        listed = {item.marker: item.reason for item in label.left_out}
        wanted = {marker["id"] for marker in entry["markers"]}
        assert wanted <= labelled | set(listed), (name, wanted - labelled - set(listed))
        assert all(listed.values())
