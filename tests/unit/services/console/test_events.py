"""A service that dies and comes back is seen to do so, once each; quiet just after the console's start."""

from __future__ import annotations

from common.messages import ServiceState
from services.console.events import ServiceWatch
from services.console.hub import EVENTS_KEPT, StateHub

S = 1_000_000_000


def beat(boot: str = "a", phase: str = "running") -> ServiceState:
    return ServiceState(service="detect.0", boot=boot, pid=1, phase=phase)  # type: ignore[arg-type]


def kinds(hub: StateHub) -> list[str]:
    return [event.fields["kind"] for event in hub.events]


def test_silence_is_told_once_and_so_is_the_return() -> None:
    hub = StateHub()
    watch = ServiceWatch(hub, 0)
    watch.hear(beat(), 0)
    for second in range(1, 6):
        watch.tick(second * S)
    assert kinds(hub) == ["service_lost"]
    watch.hear(beat("b"), 7 * S)
    watch.tick(8 * S)
    assert kinds(hub) == ["service_lost", "service_back"]
    assert hub.events[-1].fields["lost_s"] == 7.0


def test_one_that_was_back_before_anybody_noticed_is_told_too() -> None:
    hub = StateHub()
    watch = ServiceWatch(hub, 0)
    watch.hear(beat("a"), 0)
    watch.hear(beat("b"), 2 * S)
    assert kinds(hub) == ["service_back"]


def test_a_good_bye_counts_at_once_and_the_start_is_quiet() -> None:
    hub = StateHub()
    watch = ServiceWatch(hub, 0)
    watch.hear(beat(), 0)
    watch.hear(beat(phase="stopped"), S)
    assert kinds(hub) == ["service_lost"]
    quiet = StateHub()
    watch = ServiceWatch(quiet, 10 * S)
    watch.hear(beat(), 0)
    watch.tick(5 * S)
    watch.hear(beat("b"), 6 * S)
    assert kinds(quiet) == []


def test_events_are_numbered_and_500_are_kept() -> None:
    hub = StateHub()
    for _ in range(EVENTS_KEPT + 5):
        hub.happened("warning", "something")
    assert hub.last_event == EVENTS_KEPT + 5
    assert [event.n for event in hub.events_after(0)] == list(range(6, EVENTS_KEPT + 6))
    assert [event.n for event in hub.events_after(EVENTS_KEPT + 4)] == [EVENTS_KEPT + 5]


class Page:
    def __init__(self) -> None:
        self.woken = 0

    def wake(self) -> None:
        self.woken += 1

    def end(self, why: str) -> None:
        raise AssertionError(why)


def test_only_what_changed_is_told_and_nothing_old_is_kept_for_the_next_page() -> None:
    hub, page = StateHub(), Page()
    hub.add(page)
    assert hub.tell("disk", {"free": 1})
    assert not hub.tell("disk", {"free": 1})
    assert hub.tell("disk", {"free": 2})
    assert page.woken == 2
    assert hub.topics["disk"] == (2, '{"t":"state","seq":2,"topic":"disk","data":{"free":2}}')
    hub.remove(page)
    assert not hub.topics
    assert hub.tell("disk", {"free": 2})
