"""`tagmill down` amid a recording with a slow disk: all that was acknowledged or is owed is stored or refused first."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from common.bus import CommandClient, Endpoints, Poller
from common.config.models import NetworkConfig
from common.dataset import SessionReader
from tests.support.hygiene import Place, processes_of
from tests.support.stack import wait_for
from tests.support.supervised import DEADLINE_S, NO_PAGE, check_session, supervised, wait_for_samples
from tools.stack.down import stop

pytestmark = [pytest.mark.process, pytest.mark.timeout(300)]

RIG = f"""\
dataset: {{root: ./dataset, session: drain}}
{NO_PAGE}
cameras:
  cam0: {{driver: synthetic, width: 320, height: 240, fps: 10, prerendered: 4}}
ring: {{slots: 6, samples: 12}}
"""


def answer_to(client: CommandClient, number: str) -> dict[str, Any]:
    def there() -> dict[str, Any] | None:
        Poller(client).wait(0.1)
        return dict(client.receive()).get(number)

    return wait_for(there, DEADLINE_S, "the answer to what was under way when the stack was stopped")


def test_a_stop_settles_everything_that_is_owed(place: Place, tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(RIG)
    session = tmp_path / "dataset" / "drain"
    endpoints = Endpoints.of(NetworkConfig())
    # 150 ms a sample: a dozen that wait take two of the ten seconds that a drain may last.
    with supervised(tmp_path / "rig.yaml", "cam0", TAGMILL_STORE_DELAY_MS="150") as stack:
        recording = stack.ask(command="start", camera="cam0", every_s=0)["recording"]
        single = stack.ask(command="record", camera="cam0", timeout_s=60)
        wait_for_samples(session, 3)
        with CommandClient(endpoints, DEADLINE_S) as client:
            number = client.send({"command": "record", "camera": "cam0", "count": 1000, "timeout_s": 3600})
            wait_for(lambda: stack.status()["backlog"] >= 3, DEADLINE_S, "samples that wait for the disk")
            ended = stop(endpoints, DEADLINE_S)
            cut = answer_to(client, number)
    assert (ended.ran, ended.alive) == (True, ())
    assert processes_of(place.prefix) == {}
    check_session(session)
    reader = SessionReader(session)
    stored = reader.samples()
    assert single["ok"] is True
    assert (cut["ok"], cut["error"]["code"]) == (False, "stopping")
    assert {*single["samples"], *cut["samples"]} <= set(stored), "what was acknowledged is there"
    assert set(cut.get("pending", ())) <= set(stored), "so is what was ordered and not yet acknowledged"
    account = reader.session.recordings[recording].cameras["cam0"]
    assert account.settled, account
    assert account.pending == 0
    assert account.recorded == sum(reader.label(sample).recording == recording for sample in stored)
