"""How much a service logs is changed while it runs, also for loggers that were made before."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

from common import log
from common.service.levels import ALL, LEVELS_FILE, LevelWatch, read_levels, write_level
from tests.support.stack import Stack, wait_for, write_rig
from tools.cli import main


@pytest.fixture
def logged(tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "log"
    with path.open("w") as stream:
        log.setup("label.0", stream=stream)
        yield path
        log.shutdown()
    logging.getLogger().handlers.clear()


def events(path: Path) -> list[str]:
    return [json.loads(line)["event"] for line in path.read_text().splitlines()]


def test_old_loggers_follow_and_the_change_is_told(logged: Path, tmp_path: Path) -> None:
    bound = log.get().bind(camera="cam0")
    watch = LevelWatch(tmp_path, "label.0", "info")
    watch.look()
    bound.debug("a")
    write_level(tmp_path, "label.0", "debug")
    watch.look()
    bound.debug("b")
    write_level(tmp_path, "label.0", "error")
    watch.look()
    bound.warning("c")
    bound.error("d")
    write_level(tmp_path, "label.0", None)
    watch.look()
    bound.debug("e")
    bound.info("f")
    log.shutdown()
    assert events(logged) == ["log.level", "b", "log.level", "d", "log.level", "f"]


def test_one_service_s_level_goes_before_that_of_all(logged: Path, tmp_path: Path) -> None:
    write_level(tmp_path, ALL, "error")
    write_level(tmp_path, "label.0", "debug")
    LevelWatch(tmp_path, "label.0", "info").look()
    log.get().debug("mine")
    LevelWatch(tmp_path, "store", "info").look()
    log.get().warning("of the store")
    log.shutdown()
    assert events(logged)[1:] == ["mine", "log.level"]
    assert write_level(tmp_path, ALL, None) == {}


@pytest.mark.parametrize("text", ["", "[]", '{"*": "loud"}', '{"*": 3}', "{" * 5000, "x" * 70_000])
def test_a_file_that_makes_no_sense_changes_nothing(tmp_path: Path, text: str) -> None:
    (tmp_path / LEVELS_FILE).write_text(text)
    assert read_levels(tmp_path) == {}
    LevelWatch(tmp_path, "label.0", "info").look()


@pytest.mark.process
def test_a_running_service_heeds_the_command(stack: Stack, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = write_rig(tmp_path)
    assert main(["log", "debug", "--rig", str(rig)]) == 3
    process = stack.start_module("tests.support.echo", "--rig", str(rig))
    process.wait_for_event("service.opened")
    assert main(["log", "debug", "--service", "nobody", "--rig", str(rig)]) == 3
    assert "there are echo" in capsys.readouterr().err
    assert main(["log", "debug", "--service", "echo", "--rig", str(rig)]) == 0
    assert process.wait_for_event("log.level")["to"] == "debug"
    assert "numbers" in process.wait_for_event("service.report")
    assert main(["log", "default", "--rig", str(rig)]) == 0
    wait_for(lambda: len(process.events("log.level")) == 2, why="the way back")
    assert process.stop() == 0
