"""Every captured frame of a recording ends as recorded, refused, dropped or pending."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from common.labels import CameraLabel
from common.ledgers import CameraLedger
from common.messages import CameraState, FrameRef
from services.label.account import Account


def ref(count: int, boot: str = "b1", *, preview: bool = False) -> FrameRef:
    return FrameRef(
        camera="cam0",
        boot=boot,
        ring="r",
        frame=max(count, 1),
        count=0 if preview else count,
        captured_mono_ns=count,
        captured_wall_ns=count,
        preview=preview,
    )


def ended(captured: int, *, boot: str = "b1", played_for: str | None = "rec", first: int = 1) -> CameraState:
    camera = CameraLabel(name="cam0", width=4, height=4, matrix=((1, 0, 0), (0, 1, 0), (0, 0, 1)), distortion=())
    return CameraState(
        boot=boot,
        phase="ended",
        driver="files",
        ring="r",
        camera=camera,
        fps=30,
        captured=captured,
        played_for=played_for,
        play_first=first,
    )


def open_frames(account: Account) -> int:
    ledger = account.ledger()
    settled = ledger.recorded + sum(ledger.refused.values()) + sum(ledger.dropped.values())
    return ledger.captured - settled - ledger.pending


def test_a_jump_in_the_count_is_dropped_at_detect() -> None:
    account = Account()
    assert account.arrived(ref(5))
    account.refuse("no_object")
    assert account.arrived(ref(9))
    account.refuse("no_object")
    assert account.captured == 5
    assert account.dropped == {"detect": 3}
    assert open_frames(account) == 0


def test_previews_and_repeats_do_not_count() -> None:
    account = Account()
    assert not account.arrived(ref(0, preview=True))
    assert account.arrived(ref(3))
    assert not account.arrived(ref(3))
    assert not account.arrived(ref(2))
    assert account.captured == 1


def test_a_restarted_camera_counts_anew() -> None:
    account = Account()
    account.arrived(ref(100))
    account.refuse("x")
    account.arrived(ref(4, "b2"))
    account.refuse("x")
    assert account.captured == 5
    assert account.dropped == {"detect": 3}


def test_the_end_of_a_file_settles_both_ends() -> None:
    account = Account()
    for count in (13, 14, 18):
        account.arrived(ref(count))
        account.refuse("no_object")
    account.camera_ended(ended(20, first=11), "rec")
    assert account.captured == 10
    assert account.dropped == {"detect": 2 + 3 + 2}
    assert account.ledger().settled


def test_a_file_of_which_no_frame_was_detected_is_all_dropped() -> None:
    account = Account()
    account.camera_ended(ended(7, first=3), "rec")
    assert account.captured == 5
    assert account.dropped == {"detect": 5}


def test_an_end_that_belongs_to_another_recording_adds_only_what_follows() -> None:
    account = Account()
    account.arrived(ref(5))
    account.refuse("x")
    account.camera_ended(ended(8, played_for=None), "rec")
    assert account.captured == 4
    assert account.dropped == {"detect": 3}


def test_after_a_crash_of_label_the_store_is_believed_and_the_rest_is_named() -> None:
    saved = CameraLedger(captured=100, recorded=93, refused={"no_object": 4}, last_count=100, boot="b1")
    account = Account(saved)
    account.arrived(ref(111))
    account.ordered("s")
    account.stored("s")
    assert account.captured == 111
    assert account.dropped == {"label_restart": 13}
    assert account.ledger().settled


@given(
    st.lists(
        st.tuples(st.integers(1, 5), st.sampled_from(["refuse", "drop", "store", "fail", "wait"]), st.booleans()),
        max_size=60,
    )
)
def test_nothing_is_ever_unaccounted(steps: list[tuple[int, str, bool]]) -> None:
    account = Account()
    count, boot = 0, 0
    for number, (jump, fate, restart) in enumerate(steps):
        if restart:
            count, boot = 0, boot + 1
        count += jump
        account.arrived(ref(count, f"b{boot}"))
        name = f"s{number}"
        if fate == "refuse":
            account.refuse("no_object")
        elif fate == "drop":
            account.drop("label")
        else:
            account.ordered(name)
            if fate == "store":
                account.stored(name)
            elif fate == "fail":
                account.failed(name, "disk_full")
        assert open_frames(account) == 0


def test_a_file_that_plays_on_after_labels_restart_is_not_counted_twice() -> None:
    saved = CameraLedger(captured=60, recorded=60, last_count=60, boot="b1")
    account = Account(saved)
    for count in range(63, 160):
        account.arrived(ref(count))
        account.refuse("no_object")
    account.camera_ended(ended(159, first=1), "rec")
    assert account.captured == 159
    assert account.dropped == {"label_restart": 2}
    assert account.ledger().settled


def test_a_camera_restarted_in_a_later_pass_is_counted_from_its_new_life() -> None:
    account = Account()
    for count in range(160, 200):
        account.arrived(ref(count))
        account.refuse("no_object")
    for count in range(1, 160):
        account.arrived(ref(count, "b2"))
        account.refuse("no_object")
    account.camera_ended(ended(159, boot="b2", first=1), "rec")
    assert account.captured == 40 + 159
    assert account.ledger().settled


def test_what_a_restart_left_open_is_settled_at_the_end_even_without_a_further_frame() -> None:
    account = Account(CameraLedger(captured=100, recorded=90, refused={"no_object": 4}, last_count=100, boot="b1"))
    account.close()
    assert account.dropped == {"label_restart": 6}
    assert account.ledger().settled
