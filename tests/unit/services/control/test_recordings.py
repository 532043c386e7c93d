"""Recordings are learnt from the bus, joined over cameras, and forgotten when nobody speaks of them any more."""

from __future__ import annotations

from services.control.recordings import GONE_AFTER_BEATS, REMEMBER_ENDED_NS, Recordings, join
from tests.unit.services.control.known import ledger, recording_state, spec

BOTH = spec("rec-1", "cam0", "cam1")


def heard(*parts: tuple[str, str]) -> Recordings:
    recordings = Recordings()
    for camera, phase in parts:
        recordings.hear(recording_state(ledger(BOTH, phase, **{camera: 3})), "label.0", 0, 1)  # type: ignore[arg-type]
    return recordings


def test_a_recording_runs_as_long_as_one_camera_does() -> None:
    recordings = heard(("cam0", "ended"), ("cam1", "running"))
    assert recordings.open_ids() == ("rec-1",)
    assert recordings.open_cameras("rec-1") == {"cam1": "label.0"}
    joined = recordings.ledger("rec-1")
    assert joined is not None
    assert (joined.phase, joined.ended_at, sorted(joined.cameras)) == ("running", None, ["cam0", "cam1"])


def test_it_has_ended_when_all_have() -> None:
    recordings = heard(("cam0", "ended"), ("cam1", "ended"))
    assert recordings.open_ids() == ()
    joined = recordings.ledger("rec-1")
    assert joined is not None
    assert joined.phase == "ended"
    assert joined.ended_at is not None


def test_a_state_from_before_its_end_does_not_wake_it_up() -> None:
    recordings = heard(("cam0", "ended"), ("cam0", "running"))
    joined = recordings.ledger("rec-1")
    assert joined is not None
    assert joined.phase == "ended"
    recordings.hear(recording_state(ledger(BOTH, "running", cam0=3)), "label.1", 0, 1)
    assert recordings.open_cameras("rec-1") == {"cam0": "label.1"}, "another process that took it over may go on"


def test_requests_of_record_are_no_recordings_to_stop() -> None:
    recordings = Recordings()
    request = spec("rec-2", "cam0", mode="record")
    recordings.hear(recording_state(ledger(request, cam0=1)), "label.0", 0, 1)
    assert recordings.open_ids() == ()


def test_what_a_well_label_process_no_longer_tells_is_gone() -> None:
    recordings = heard(("cam0", "running"))
    recordings.tidy(10**15, lambda _: GONE_AFTER_BEATS)
    assert recordings.open_ids() == ("rec-1",), "a silent label process may still know it"
    recordings.tidy(0, lambda _: GONE_AFTER_BEATS + 1)
    assert recordings.known == {}


def test_ended_ones_are_remembered_for_a_minute() -> None:
    recordings = heard(("cam0", "ended"))
    recordings.tidy(REMEMBER_ENDED_NS, lambda _: 1000)
    assert recordings.ledger("rec-1") is not None
    recordings.tidy(REMEMBER_ENDED_NS + 1, lambda _: 1000)
    assert recordings.ledger("rec-1") is None


def test_a_later_part_wins_and_no_parts_are_none() -> None:
    assert join([]) is None
    joined = join([ledger(BOTH, "ended", cam0=1, cam1=2), ledger(BOTH, "ended", cam0=5)])
    assert joined is not None
    assert {name: account.captured for name, account in joined.cameras.items()} == {"cam0": 5, "cam1": 2}


def test_parts_leave_out_what_is_told_elsewhere() -> None:
    recordings = heard(("cam0", "ended"), ("cam1", "running"))
    assert [list(part.cameras) for part in recordings.parts("rec-1", but=(), ended=True)] == [["cam0"]]
    assert recordings.parts("rec-1", but={"cam0"}, ended=True) == ()
    assert recordings.parts("rec-9", but=(), ended=False) == ()
