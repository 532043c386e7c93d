"""CPU of a service with its worker processes."""

from __future__ import annotations

import os
from pathlib import Path

from common import clock
from common.service.cpu import CpuMeter


def process(proc: Path, pid: int, user: int, system: int, children: str = "") -> None:
    task = proc / str(pid) / "task" / str(pid)
    task.mkdir(parents=True, exist_ok=True)
    (task / "children").write_text(children)
    # A name may hold brackets and spaces.
    (proc / str(pid) / "stat").write_text(
        f"{pid} (a (b) c) S 1 1 1 0 -1 0 0 0 0 0 {user} {system} 0 0 20 0 1 0 0 0 0\n"
    )


def test_the_process_and_its_children_are_added_up_and_a_new_or_ended_child_does_no_harm(tmp_path: Path) -> None:
    own, ticks = os.getpid(), os.sysconf("SC_CLK_TCK")
    process(tmp_path, own, 100, 50, "77 88 ")
    process(tmp_path, 77, 1000, 0)
    begin = clock.monotonic_ns()
    meter = CpuMeter(tmp_path, least_s=0.0)
    process(tmp_path, own, 100 + ticks, 50 + ticks, "77 99")
    process(tmp_path, 77, 1000 + 3 * ticks, 0)
    process(tmp_path, 99, 10**6, 0)
    found = meter.percent()
    at_most_s = (clock.monotonic_ns() - begin) / 1e9
    assert found >= 500.0 / max(at_most_s, 1e-3) * 0.99, "five seconds of work in the time that passed"
    process(tmp_path, own, 0, 0)
    assert meter.percent() == 0.0


def test_a_machine_without_proc_gives_nought(tmp_path: Path) -> None:
    assert CpuMeter(tmp_path, least_s=0.0).percent() == 0.0


def test_the_real_one_counts_this_process() -> None:
    assert CpuMeter(least_s=0.0).percent() >= 0.0
    assert CpuMeter(least_s=3600.0).percent() == 0.0, "too soon to say"
