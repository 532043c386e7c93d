"""The real store process and its bin: delete, restore, list, undo; kills at any moment; full and read-only disks."""

from __future__ import annotations

import contextlib
import json
import random
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from common.bus import CommandClient
from common.dataset import label_path, picture_path, read_session
from common.dataset.bin import bin_of
from common.errors import EXIT_FOUND, EXIT_OK, EXIT_REFUSED
from common.ledgers import CameraLedger
from common.messages import SamplesChanged
from common.topics import SAMPLES, SERVICE
from tests.support.mounts import make_read_only, small_disk
from tests.support.samples import StoreSide, spec
from tests.support.sessions import frames, make_session, places
from tests.support.stack import ServiceProcess, Stack, write_rig
from tools.cli import main

pytestmark = pytest.mark.process

SHORT_KILLS, LONG_KILLS = 3, 40
MOST_OPEN = 3


@pytest.fixture
def label_side(stack: Stack) -> Iterator[StoreSide]:
    stack.endpoints.prepare()
    side = StoreSide(stack.endpoints)
    yield side
    side.close()


def start(stack: Stack) -> ServiceProcess:
    """A store that is there: an order sent before could go to a killed one, whose end nobody has noticed yet."""
    store = stack.start_service("store", write_rig(stack.folder), TAGMILL_STORE_RESERVE_MB="0")
    store.wait_for_event("service.opened")
    return store


def session_of(stack: Stack, name: str = "test") -> Path:
    return stack.folder / "dataset" / name


def store_all(side: StoreSide, *numbers: int) -> tuple[str, ...]:
    keys = tuple(side.store(number) for number in numbers)
    for key in keys:
        assert side.answer_to(key).error is None
    return keys


def names(side: StoreSide, **wanted: Any) -> tuple[str, ...]:
    return tuple(item.name for item in side.listed(**wanted).samples)


def test_deleted_and_restored_samples_are_durable_counted_and_survive_a_restart(
    stack: Stack, label_side: StoreSide
) -> None:
    store = start(stack)
    one, two, three = store_all(label_side, 1, 2, 3)
    ended = CameraLedger(captured=3, labelled=3, recorded=3)
    label_side.answer_to(label_side.ledger(spec(), ended, ended=True))
    assert label_side.answer_to(label_side.move("bin", one, three)).samples == (one, three)
    assert places(session_of(stack)) == {one: "bin", two: "session", three: "bin"}
    assert names(label_side) == (two,)
    assert names(label_side, bin=True) == (three, one)

    def account() -> tuple[int, int, bool]:
        (ledger,) = label_side.query("rec-a").ledgers
        found = ledger.cameras["cam0"]
        return found.recorded, found.deleted, found.settled

    assert account() == (3, 2, True)
    store.kill()
    start(stack)
    assert account() == (3, 2, True)
    assert names(label_side, bin=True) == (three, one)
    assert label_side.answer_to(label_side.move("session", three)).samples == (three,)
    assert account() == (3, 1, True)
    assert label_side.session("test").text == "test", "and all is written"
    assert read_session(session_of(stack)).recordings["rec-a"].cameras["cam0"].deleted == 1
    assert names(label_side) == (three, two)


def test_a_repeated_order_for_a_deleted_sample_is_answered_and_stores_nothing(
    stack: Stack, label_side: StoreSide
) -> None:
    store = start(stack)
    order = label_side.order(1)
    assert order is not None
    label_side.answer_to(label_side.send(order))
    label_side.answer_to(label_side.move("bin", order.key))
    for _ in range(2):
        label_side.answers.clear()
        assert label_side.answer_to(label_side.send(order)).samples == (order.key,)
        assert places(session_of(stack)) == {order.key: "bin"}
        store.kill()
        store = start(stack)
    store.kill()
    assert main(["dataset", "empty-bin", "--yes", "--session", str(session_of(stack))]) == EXIT_OK
    start(stack)
    label_side.answers.clear()
    assert label_side.answer_to(label_side.send(order)).samples == (order.key,)
    assert places(session_of(stack)) == {}
    account = CameraLedger(captured=1, recorded=1)
    (ledger,) = label_side.answer_to(label_side.ledger(spec(), account, ended=True)).ledgers
    assert (ledger.cameras["cam0"].recorded, ledger.cameras["cam0"].deleted) == (1, 1)


def test_single_requests_count_what_was_deleted_of_them(stack: Stack, label_side: StoreSide) -> None:
    start(stack)
    request = spec("rec-7").model_copy(update={"mode": "record"})
    sample = label_side.store(1, recording="rec-7")
    label_side.answer_to(sample)
    label_side.answer_to(label_side.ledger(request, CameraLedger(captured=1, recorded=1), ended=True))
    label_side.answer_to(label_side.move("bin", sample))
    (found,) = label_side.query("rec-7").ledgers
    assert (found.cameras["cam0"].recorded, found.cameras["cam0"].deleted) == (1, 1)
    label_side.session("test")
    assert read_session(session_of(stack)).records["cam0"].deleted == 1


def test_refusals_change_nothing(stack: Stack, label_side: StoreSide) -> None:
    start(stack)
    one, _ = store_all(label_side, 1, 2)
    before = places(session_of(stack))
    for name in ("../../../etc/passwd", "20260101T000000.000Z-cam0-9", ""):
        for to in ("bin", "session"):
            error = label_side.error_of(label_side.move(to, one, name))  # type: ignore[arg-type]
            assert error.code == "no_sample"
    assert places(session_of(stack)) == before
    assert label_side.answer_to(label_side.move("session", one)).samples == (one,), "it never was in the bin"


def test_another_session_is_listed_from_its_folder(stack: Stack, label_side: StoreSide) -> None:
    start(stack)
    store_all(label_side, 1)
    other = session_of(stack, "tuesday")
    samples = make_session(other, *frames(5, 6))
    assert names(label_side, session="tuesday") == tuple(reversed(samples))
    make_session(other, *frames(7))
    assert label_side.listed(session="tuesday").total == 3, "it is read again when it has changed"
    assert names(label_side, session="test") == names(label_side)
    label_side.session("wednesday")
    assert label_side.listed().stored == 0
    assert label_side.listed(session="test").stored == 1
    assert label_side.answers
    with pytest.raises(AssertionError, match="unknown_session"):
        label_side.listed(session="nowhere")


def test_a_move_on_a_read_only_disk_is_refused_whole_and_works_again_later(stack: Stack, label_side: StoreSide) -> None:
    with small_disk(stack.folder / "dataset", 2) as disk:
        store = start(stack)
        one, two = store_all(label_side, 1, 2)
        make_read_only(disk)
        assert label_side.error_of(label_side.move("bin", one, two)).code == "read_only"
        make_read_only(disk, read_only=False)
        assert places(session_of(stack)) == {one: "session", two: "session"}
        assert label_side.answer_to(label_side.move("bin", one, two)).samples == (one, two)
        assert names(label_side, bin=True) == (two, one)
        assert store.stop() == 0


def test_a_full_disk_keeps_nobody_from_deleting(stack: Stack, label_side: StoreSide) -> None:
    with small_disk(stack.folder / "dataset", 1) as disk:
        store = start(stack)
        (one,) = store_all(label_side, 1)
        with (disk / "ballast").open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while file.write(bytes(4096)):
                pass
        assert label_side.answer_to(label_side.move("bin", one)).error is None
        assert places(session_of(stack)) == {one: "bin"}
        assert store.stop() == 0


# --- kills ------------------------------------------------------------------------------------------------


def test_kill_9_while_samples_are_moved(stack: Stack, label_side: StoreSide) -> None:
    kill_again_and_again(stack, label_side, SHORT_KILLS, seed=20260830)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_kill_9_while_samples_are_moved_for_long(stack: Stack, label_side: StoreSide) -> None:
    kill_again_and_again(stack, label_side, LONG_KILLS, seed=17)


def kill_again_and_again(stack: Stack, side: StoreSide, kills: int, seed: int) -> None:
    """What was answered is so after a kill; what was not is whole in one place, and repeating the order settles it."""
    chance = random.Random(seed)
    store = start(stack)
    samples = store_all(side, *range(1, 13))
    where = dict.fromkeys(samples, "session")
    cut_off = answered = 0
    for _ in range(kills):
        asked: list[tuple[str, str, tuple[str, ...]]] = []
        kill_at: float | None = None
        while kill_at is None or time.monotonic() < kill_at:
            if sum(key not in side.answers for key, _, _ in asked) >= MOST_OPEN:
                side.receive(0.01)
            if kill_at is None and any(key in side.answers for key, _, _ in asked):
                kill_at = time.monotonic() + chance.uniform(0.0, 0.1)
            if len(asked) >= MOST_OPEN and asked[-MOST_OPEN][0] not in side.answers:
                continue
            chosen = tuple(chance.sample(samples, chance.randint(1, 6)))
            to = chance.choice(("bin", "session"))
            asked.append((side.move(to, *chosen), to, chosen))  # type: ignore[arg-type]
            side.receive(0.001)
        store.kill()
        side.receive(0.0)
        open_ones: list[tuple[str, tuple[str, ...]]] = []
        for key, to, chosen in asked:
            if key in side.answers:
                assert side.answers[key].error is None
                where |= dict.fromkeys(chosen, to)
                answered += 1
            else:
                open_ones.append((to, chosen))
                side.client.forget(key)
        store = start(stack)
        total = side.listed(limit=0)
        found = places(session_of(stack))
        assert (total.stored, total.in_bin) == tuple(list(found.values()).count(place) for place in ("session", "bin"))
        touched = {sample for _, chosen in open_ones for sample in chosen}
        cut_off += bool(touched)
        assert set(found) == set(samples)
        assert {name: place for name, place in found.items() if name not in touched} == {
            name: place for name, place in where.items() if name not in touched
        }
        for to, chosen in open_ones:
            assert side.answer_to(side.move(to, *chosen)).error is None  # type: ignore[arg-type]
            where |= dict.fromkeys(chosen, to)
        assert places(session_of(stack)) == where
    assert answered >= kills
    assert cut_off >= kills // 3, "the kills must have met a busy store"
    assert store.stop() == 0


# --- over the command socket ------------------------------------------------------------------------------


Ask = Callable[..., dict[str, Any]]


@pytest.fixture
def ask(stack: Stack, label_side: StoreSide) -> Iterator[Ask]:
    """Control and store, with five samples of cam0; asks the command socket."""
    stack.start_service("control", write_rig(stack.folder))
    start(stack)
    stack.listen(SERVICE).wait_for_state("store")
    store_all(label_side, 1, 2, 3, 4, 5)
    with CommandClient(stack.endpoints) as client:
        yield lambda **fields: json.loads(json.dumps(client.request(fields, 40.0)))


def undo_goes_further_back_each_time_and_restore_puts_back(ask: Ask, stack: Stack) -> None:
    newest = [item["name"] for item in ask(command="samples")["samples"]]
    assert len(newest) == 5
    assert ask(command="undo") == {"ok": True, "samples": [newest[0]]}
    assert ask(command="undo", camera="cam0") == {"ok": True, "samples": [newest[1]]}
    assert ask(command="undo", camera="cam1")["error"]["code"] == "nothing_to_undo"
    assert ask(command="restore", samples=newest[:2]) == {"ok": True, "samples": newest[:2]}
    assert ask(command="undo") == {"ok": True, "samples": [newest[0]]}
    assert ask(command="delete", samples=newest) == {"ok": True, "samples": newest}
    refused = ask(command="undo")
    assert refused["error"]["code"] == "nothing_to_undo"
    assert set(places(session_of(stack)).values()) == {"bin"}
    answer = ask(command="samples", filter={"bin": True, "object": "box-0"}, offset=1, limit=2)
    assert [item["name"] for item in answer["samples"]] == newest[1:3]
    assert (answer["session"], answer["total"], answer["stored"], answer["in_bin"]) == ("test", 5, 0, 5)
    assert answer["next_offset"] == 3
    (found,) = answer["samples"][0]["objects"]
    assert {"azimuth_deg", "elevation_deg", "distance_mm"} <= set(found)


WRONG: tuple[tuple[dict[str, Any], str, str], ...] = (
    ({"command": "delete"}, "missing_field", "samples"),
    ({"command": "delete", "samples": []}, "out_of_bounds", "1..500 names"),
    ({"command": "delete", "samples": "a"}, "wrong_type", "'samples'"),
    ({"command": "delete", "samples": [3]}, "wrong_type", "'samples'"),
    ({"command": "restore", "samples": ["../x"]}, "no_sample", "../x"),
    ({"command": "samples", "limit": 501}, "out_of_bounds", "0..500"),
    ({"command": "samples", "session": "../etc"}, "out_of_bounds", "session"),
    ({"command": "samples", "session": "nowhere"}, "unknown_session", "nowhere"),
    ({"command": "samples", "filter": {"colour": "red"}}, "unknown_field", "'filter' of 'samples' has no field"),
    ({"command": "samples", "filter": {"sidee": "red"}}, "unknown_field", "did you mean 'side'"),
    ({"command": "samples", "filter": {"bin": 1}}, "wrong_type", "'filter.bin' must be true or false"),
    ({"command": "samples", "filter": 3}, "wrong_type", "'filter' must be a map"),
)


def what_is_wrong_is_said_and_changes_nothing(ask: Ask, stack: Stack) -> None:
    before = places(session_of(stack))
    for request, code, part in WRONG:
        answer = ask(**request)
        assert (answer["error"]["code"], request) == (code, request)
        assert part in answer["error"]["message"]
    assert places(session_of(stack)) == before


def everybody_hears_at_once_what_was_stored_deleted_and_restored(ask: Ask, stack: Stack, label_side: StoreSide) -> None:
    listener = stack.listen(SAMPLES, SERVICE)
    listener.wait_for_state("store")

    def news() -> SamplesChanged:
        heard = listener.wait_for(lambda received: isinstance(received.message, SamplesChanged)).message
        assert isinstance(heard, SamplesChanged)
        return heard

    (sample,) = store_all(label_side, 6)
    told = news()
    assert (told.what, told.samples, told.session, told.stored, told.in_bin) == ("stored", (sample,), "test", 6, 0)
    ask(command="undo")
    told = news()
    assert (told.what, told.samples, told.stored, told.in_bin) == ("deleted", (sample,), 5, 1)
    ask(command="delete", samples=[sample])
    ask(command="restore", samples=[sample])
    told = news()
    assert (told.what, told.samples, told.stored, told.in_bin) == ("restored", (sample,), 6, 0)


def the_command_line_asks_the_stack_that_has_the_session_open(
    ask: Ask, stack: Stack, capsys: pytest.CaptureFixture[str]
) -> None:
    newest = [item["name"] for item in ask(command="samples")["samples"]]
    rig = ("--rig", str(stack.folder / "rig.yaml"))
    assert main(["undo", *rig]) == EXIT_OK
    assert newest[0] in capsys.readouterr().out
    assert main(["dataset", "delete", newest[1], *rig]) == EXIT_OK
    assert main(["dataset", "list", "--bin", "--json", *rig]) == EXIT_OK
    listed = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [item["name"] for item in listed["samples"]] == newest[:2]
    assert main(["dataset", "restore", *newest[:2], "--session", str(session_of(stack)), *rig]) == EXIT_OK
    assert ask(command="samples", limit=0)["stored"] == 5
    assert main(["dataset", "delete", "nothing", *rig]) == EXIT_REFUSED
    assert main(["dataset", "empty-bin", "--yes", *rig]) == EXIT_REFUSED
    assert "tagmill down" in capsys.readouterr().err


def what_inspect_finds_broken_is_moved_by_the_stack(ask: Ask, stack: Stack, capsys: pytest.CaptureFixture[str]) -> None:
    (newest,) = [item["name"] for item in ask(command="samples", limit=1)["samples"]]
    rig = ("--rig", str(stack.folder / "rig.yaml"))
    picture = session_of(stack) / picture_path("rgb", newest)
    whole = picture.read_bytes()
    picture.write_bytes(whole[:-20])
    alone = session_of(stack) / "rgb" / f"rgb_{newest.replace('cam0', 'cam9')}.png"
    alone.write_bytes(whole)
    assert main(["inspect", str(session_of(stack)), "--repair", *rig]) == EXIT_FOUND
    told = capsys.readouterr().out
    assert "1 broken sample is in the bin" in told
    assert "the running stack may be about to write" in told
    assert alone.exists()
    assert ask(command="samples", filter={"bin": True})["samples"][0]["name"] == newest
    alone.unlink()
    ask(command="restore", samples=[newest])
    picture.write_bytes(whole)


def new_sessions_are_made_of_the_one_that_is_being_recorded(
    ask: Ask, stack: Stack, label_side: StoreSide, capsys: pytest.CaptureFixture[str]
) -> None:
    """Samples come in all the while; those answered before are in the new session, whole, with their account."""
    rig = ("--rig", str(stack.folder / "rig.yaml"))
    label_side.answer_to(label_side.ledger(spec("rec-live"), CameraLedger(captured=9, recorded=0), ended=False))
    made = {}
    for name, words in (
        ("renamed", ["rename-class", str(session_of(stack)), "front", "face", "--into", "renamed"]),
        ("test-cam0", ["split", str(session_of(stack)), "--by", "camera"]),
    ):
        before = ask(command="samples", limit=500)["samples"]
        under_way = [label_side.store(100 + len(before) + n, recording="rec-live") for n in range(4)]
        assert main(["dataset", *words, *rig]) == EXIT_OK
        for key in under_way:
            assert label_side.answer_to(key).error is None
        made[name] = set(places(session_of(stack, name)))
        assert made[name] >= {item["name"] for item in before}
        capsys.readouterr()
        main(["inspect", str(session_of(stack, name)), "--verify", "--json", *rig])
        problems = json.loads(capsys.readouterr().out)["problems"]
        assert [one for one in problems if one["kind"] != "contradiction"] == []
    assert (
        main(["dataset", "merge", str(session_of(stack)), str(session_of(stack, "renamed")), "--into", "x", *rig])
        == EXIT_REFUSED
    )
    assert "different rigs" in capsys.readouterr().err
    ledger = read_session(session_of(stack, "test-cam0")).recordings["rec-live"]
    assert (ledger.phase, ledger.cameras["cam0"].settled) == ("interrupted", True)
    label_side.answer_to(label_side.ledger(spec("rec-live"), CameraLedger(captured=9, recorded=8), ended=True))


def a_ledger_tells_what_was_deleted_whoever_keeps_it(ask: Ask, label_side: StoreSide) -> None:
    label_side.answer_to(label_side.ledger(spec(), CameraLedger(captured=5, recorded=5), ended=True))
    (undone,) = ask(command="undo")["samples"]
    account = ask(command="ledger", recording="rec-a")["ledger"]["cameras"]["cam0"]
    assert (account["recorded"], account["deleted"]) == (5, 1)
    ask(command="restore", samples=[undone])


def test_over_the_command_socket(
    ask: Ask, stack: Stack, label_side: StoreSide, capsys: pytest.CaptureFixture[str]
) -> None:
    what_is_wrong_is_said_and_changes_nothing(ask, stack)
    a_ledger_tells_what_was_deleted_whoever_keeps_it(ask, label_side)
    everybody_hears_at_once_what_was_stored_deleted_and_restored(ask, stack, label_side)
    new_sessions_are_made_of_the_one_that_is_being_recorded(ask, stack, label_side, capsys)


def test_undo_and_restore_by_hand_and_by_command_line(
    ask: Ask, stack: Stack, capsys: pytest.CaptureFixture[str]
) -> None:
    the_command_line_asks_the_stack_that_has_the_session_open(ask, stack, capsys)
    what_inspect_finds_broken_is_moved_by_the_stack(ask, stack, capsys)
    undo_goes_further_back_each_time_and_restore_puts_back(ask, stack)


def test_a_restart_finishes_a_cut_off_delete_and_says_so(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack)
    one, two = store_all(label_side, 1, 2)
    label_side.answer_to(label_side.move("bin", two))
    store.kill()
    (session_of(stack) / label_path(one)).rename(bin_of(session_of(stack)) / label_path(one))
    store = start(stack)
    assert len(store.wait_for_event("recovery.settled")["names"]) == 2
    assert places(session_of(stack)) == {one: "bin", two: "bin"}
    assert names(label_side, bin=True) == (two, one)
