"""kill -9 of each service and each worker process in the middle of a recording, under a real supervisord."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from common.dataset import SessionReader, read_session
from common.frames import sweep
from common.ledgers import CameraLedger
from tests.support.hygiene import Place
from tests.support.supervised import DEADLINE_S, NO_PAGE, SupervisedStack, check_session, supervised, wait_for_samples

pytestmark = [pytest.mark.process, pytest.mark.timeout(400)]

SEED = 20260830
RIG = f"""\
dataset: {{root: ./dataset, session: kills}}
{NO_PAGE}
cameras:
  cam0: {{driver: synthetic, width: 320, height: 240, fps: 6, prerendered: 6}}
ring: {{slots: 12, samples: 16}}
"""


def kill_service(program: str) -> Callable[[SupervisedStack], None]:
    def kill(stack: SupervisedStack) -> None:
        stack.wait_back(program, stack.kill(program))

    return kill


def kill_worker(program: str) -> Callable[[SupervisedStack], None]:
    """A worker is replaced by its service, which itself goes on as the process that it was."""

    def kill(stack: SupervisedStack) -> None:
        before = stack.pids()[program]
        stack.workers(program)[0].kill()
        assert stack.pids()[program] == before

    return kill


VICTIMS = {
    "capture": kill_service("capture-cam0"),
    "detect": kill_service("detect"),
    "label": kill_service("label"),
    "store": kill_service("store"),
    "control": kill_service("control"),
    "label's worker": kill_worker("label"),
    "store's worker": kill_worker("store"),
}


def settle(stack: SupervisedStack, recording: str) -> dict[str, Any]:
    """Stop the recording; its ledger."""
    answer = stack.ask(command="stop", recording=recording)
    assert answer["ok"], answer
    (ledger,) = answer["ledgers"]
    assert ledger["phase"] == "ended"
    return dict(ledger)


def check_account(session: Path, recording: str, ledger: dict[str, Any]) -> CameraLedger:
    """What `stop` answered, what session.json says and what is on the disk are one and the same account."""
    account = CameraLedger.model_validate(ledger["cameras"]["cam0"])
    assert account.pending == 0
    assert account.settled, account
    kept = read_session(session).recordings[recording]
    assert kept.phase == "ended"
    assert kept.cameras["cam0"] == account
    reader = SessionReader(session)
    by_recording = Counter(reader.label(sample).recording for sample in reader.samples())
    assert by_recording[recording] == account.recorded
    return account


def test_a_recording_goes_on_through_the_death_of_every_process(tmp_path: Path, place: Place) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG)
    session = tmp_path / "dataset" / "kills"
    order = random.Random(SEED).sample(sorted(VICTIMS), len(VICTIMS))
    with supervised(rig, "cam0") as stack:
        started = stack.ask(command="start", camera="cam0", every_s=0)
        assert started["ok"], started
        for victim in order:
            wait_for_samples(session, 5)
            VICTIMS[victim](stack)
        wait_for_samples(session, 5)
        stack.wait_ready("cam0")
        acknowledged = stack.ask(command="record", camera="cam0", count=2, timeout_s=60)
        assert acknowledged["ok"], acknowledged
        ledger = settle(stack, started["recording"])
        assert sweep(place.prefix) == []  # each restart has cleared what its dead predecessor left
    account = check_account(session, started["recording"], ledger)
    assert account.recorded >= 5 * (len(VICTIMS) + 1)
    assert set(account.dropped) <= {"detect", "label", "label_restart", "store"}
    check_session(session)
    assert set(acknowledged["samples"]) <= set(SessionReader(session).samples())


@pytest.mark.long
def test_what_label_was_asked_for_before_its_death_is_neither_forgotten_nor_done_twice(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG)
    session = tmp_path / "dataset" / "kills"
    with supervised(rig, "cam0") as stack, ThreadPoolExecutor(1) as aside:
        recorded = aside.submit(stack.ask, command="record", camera="cam0", count=8, interval_s=0.5, timeout_s=60)
        wait_for_samples(session, 2)
        killed = stack.kill("label")
        answer = recorded.result(DEADLINE_S)
        assert answer["ok"], answer
        reader = SessionReader(session)
        assert sorted(answer["samples"]) == list(reader.samples()), "those of both lives, and not one too many"
        assert len(answer["samples"]) == 8
        stack.wait_back("label", killed)
        account = stack.ask(command="ledger", recording=answer["recording"])["ledger"]["cameras"]["cam0"]
        assert account["recorded"] == 8
        assert CameraLedger.model_validate(account).settled

        started = stack.ask(command="start", camera="cam0", every_s=0)
        wait_for_samples(session, 2)
        stack.kill("label")
        ledger = settle(stack, started["recording"])  # asked while label is away or has only just come back
    check_account(session, started["recording"], ledger)
    check_session(session)


@pytest.mark.long
def test_kills_at_random_moments(tmp_path: Path, place: Place) -> None:
    """Two at a time, one while the other is still coming back; a recording each round."""
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG)
    session = tmp_path / "dataset" / "kills"
    chance = random.Random(SEED + 1)
    services = ["capture-cam0", "detect", "label", "store", "control"]
    ledgers = {}
    with supervised(rig, "cam0") as stack:
        for _ in range(3):
            started = stack.ask(command="start", camera="cam0", every_s=0)
            assert started["ok"], started
            wait_for_samples(session, chance.randint(1, 8))
            first, second = chance.sample(services, 2)
            killed = {first: stack.kill(first), second: stack.kill(second)}
            for program, pid in killed.items():
                stack.wait_back(program, pid)
            stack.wait_ready("cam0")
            wait_for_samples(session, 2)
            ledgers[started["recording"]] = settle(stack, started["recording"])
        assert sweep(place.prefix) == []
    for recording, ledger in ledgers.items():
        check_account(session, recording, ledger)
    check_session(session)
