"""What control makes of the states on the bus: when it knows enough, whom it shares what out to, what `status` says."""

from __future__ import annotations

from pathlib import Path

import msgpack
import pytest

from common.bus import Endpoints
from common.commands import COMMANDS
from common.config import load_rig
from common.config.models import NetworkConfig
from common.errors import RefusedError
from services.control.conversations import Keys
from services.control.service import handlers
from services.control.stack import SETTLE_AT_LATEST_NS, SETTLE_NS, Stack
from services.control.status import status_answer
from tests.unit.services.control.known import SECOND, camera, ledger, recording_state, service, spec

RIG = """\
dataset: {root: ./data, session: monday}
cameras:
  cam0: {driver: synthetic, width: 320, height: 240}
workers: {detect: 1, label: 2}
"""
EVERYBODY = ("detect.0", "label.0", "label.1", "store")


@pytest.fixture
def stack(tmp_path: Path) -> Stack:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    return Stack(load_rig(path), Endpoints.of(NetworkConfig()), now_ns=0)


def settle(stack: Stack, *silent: str) -> None:
    for name in EVERYBODY:
        if name not in silent:
            stack.hear(service(name), name, 0)
    stack.tick(SETTLE_AT_LATEST_NS if silent else SETTLE_NS)
    assert stack.settled


def test_every_command_has_a_handler(stack: Stack) -> None:
    assert set(handlers(stack, Keys("b"))) == set(COMMANDS)


def test_it_is_settled_after_a_round_of_heartbeats(stack: Stack) -> None:
    for name in EVERYBODY:
        stack.hear(service(name), name, 0)
    stack.tick(SETTLE_NS - 1)
    assert not stack.settled
    assert stack.shares.label == {}
    stack.tick(SETTLE_NS)
    assert stack.settled
    assert stack.shares.label == {"cam0": 0}


def test_somebody_silent_is_waited_for_but_not_for_ever(stack: Stack) -> None:
    for name in EVERYBODY[:-1]:
        stack.hear(service(name), name, 0)
    stack.tick(SETTLE_AT_LATEST_NS - 1)
    assert not stack.settled
    stack.tick(SETTLE_AT_LATEST_NS)
    assert stack.settled


def test_a_restarted_control_takes_the_shares_from_the_heartbeats(stack: Stack) -> None:
    stack.hear(service("label.1", cameras=("cam0",)), "label.1", 0)
    settle(stack, "label.1")
    assert stack.shares.label == {"cam0": 1}
    assert stack.label_of("cam0") == "label.1"


def test_a_camera_that_announces_itself_is_known_and_served(stack: Stack) -> None:
    settle(stack)
    stack.hear(camera("cam7"), "capture.cam7", SETTLE_NS)
    assert stack.chosen("all") == ("cam0", "cam7")
    assert stack.label_of("cam7") == "label.1"
    assert stack.present("cam7", SETTLE_NS + SECOND)
    assert not stack.present("cam0", SETTLE_NS)
    assert "capture.cam7" in stack.expected
    stack.tick(SETTLE_NS + 61 * SECOND)
    assert stack.chosen("all") == ("cam0",)


def test_an_unknown_camera_is_refused_with_the_known_ones(stack: Stack) -> None:
    with pytest.raises(RefusedError, match="known: cam0") as caught:
        stack.chosen("cam1")
    assert caught.value.code == "no_camera"


def test_status_tells_services_cameras_recordings(stack: Stack) -> None:
    settle(stack)
    at = SETTLE_NS
    stack.hear(camera("cam0", captured=40, lost={"unplugged": 1}), "capture.cam0", at)
    stack.hear(service("label.0", numbers={"backlog": 3.0}, dropped={"superseded": 2}), "label.0", at)
    stack.hear(service("store", numbers={"free_bytes": 5e9}, last_error="slow"), "store", at)
    told = ledger(spec("rec-1", "cam0", until_count=9), cam0=4)
    stack.hear(recording_state(told, waiting_for="no_object"), "label.0", at)
    answer = status_answer(stack, at + SECOND)
    msgpack.packb(answer)
    assert answer["missing"] == ["capture.cam0", "control"]
    assert answer["services"]["store"]["last_error"] == "slow"
    assert (
        answer["services"]["label.0"] | {"alive": True, "age_s": 1.0, "dropped": {"superseded": 2}}
        == (answer["services"]["label.0"])
    )
    assert answer["cameras"]["cam0"]["captured"] == 40
    assert answer["cameras"]["cam0"]["calibration"] == "calibration"
    assert answer["recordings"]["rec-1"]["cameras"]["cam0"]["recorded"] == 4
    assert answer["recordings"]["rec-1"]["waiting_for"] == {"cam0": "no_object"}
    assert (answer["backlog"], answer["disk"], answer["session"]) == (3, {"free_bytes": 5_000_000_000}, "monday")


def test_status_is_silent_on_what_was_not_heard(stack: Stack) -> None:
    answer = status_answer(stack, 0)
    assert answer["services"] == {}
    assert answer["disk"] == {"free_bytes": None}
    assert set(answer["missing"]) == {*EVERYBODY, "capture.cam0", "control"}
