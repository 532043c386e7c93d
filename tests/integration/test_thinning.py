"""A store that can't keep up: a recording is thinned evenly and says so, a single request always finds its place."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from common.dataset import SessionReader
from tests.support.stack import wait_for
from tests.support.supervised import DEADLINE_S, NO_PAGE, check_session, supervised

pytestmark = [pytest.mark.process, pytest.mark.timeout(600)]

SLOTS = 16
WANTED = 48
SPANS = 4


def write_rig(folder: Path) -> Path:
    path = folder / "rig.yaml"
    path.write_text(
        f"dataset: {{root: ./dataset, session: slow}}\n{NO_PAGE}\nring: {{slots: 60, samples: {SLOTS}}}\n"
        "workers: {finish: 1, store: 1}\ncameras:\n"
        "  cam0: {driver: synthetic, width: 320, height: 180, fps: 12, prerendered: 8, burn_frame: true}\n"
    )
    return path


def test_a_slow_store_thins_a_recording_and_never_a_single_request(tmp_path: Path) -> None:
    session = tmp_path / "dataset" / "slow"
    with supervised(write_rig(tmp_path), "cam0", TAGMILL_STORE_DELAY_MS="200") as stack:
        recording = stack.ask(command="start", camera="cam0")["recording"]

        def thinned() -> bool:
            account = stack.ask(command="ledger", recording=recording)["ledger"]["cameras"]["cam0"]
            return account["refused"].get("thinned", 0) > 0

        wait_for(thinned, DEADLINE_S, "the recording to be thinned")
        singles = [stack.ask(command="record", camera="cam0", timeout_s=60) for _ in range(3)]
        assert [answer["ok"] for answer in singles] == [True] * 3, "with the buffer full of the recording's samples"

        def enough() -> bool:
            return stack.ask(command="ledger", recording=recording)["ledger"]["cameras"]["cam0"]["recorded"] >= WANTED

        wait_for(enough, DEADLINE_S, f"{WANTED} samples")
        stopped = stack.ask(command="stop", recording=recording)
        assert stopped["ok"], stopped
        account = stopped["ledgers"][0]["cameras"]["cam0"]
    accounted = account["recorded"] + sum(account["refused"].values()) + sum(account["dropped"].values())
    assert account["captured"] == accounted
    assert account["refused"]["thinned"] > 0
    check_session(session)
    reader = SessionReader(session)
    labels = [reader.label(sample) for sample in reader.samples()]
    assert {name for answer in singles for name in answer["samples"]} <= {label.sample for label in labels}
    frames = sorted(label.frame for label in labels if label.recording == recording)
    assert len(frames) == account["recorded"]
    # Once the buffer was full, each quarter of the time has its part.
    settled = frames[SLOTS:]
    length = (settled[-1] - settled[0] + 1) / SPANS
    counts = Counter(int((frame - settled[0]) / length) for frame in settled)
    assert min(counts[span] for span in range(SPANS)) >= len(settled) / SPANS / 3, (counts, frames)
