"""Rules of the house that a machine can check and that no linter knows."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from common.commands import COMMANDS, GENERAL_ERRORS
from common.topics import TOPICS
from common.words import WORDS

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("services", "common", "tools")
MAX_LINES = 300

LONG_MODULES: dict[str, str] = {}
"""Modules that may be longer, each with its reason; one that has become shorter must leave the list."""

SLEEPERS: dict[str, str] = {
    "services/capture/cameras/pacing.py": "a camera's frame rate is time itself",
    "services/label/service.py": "TAGMILL_LABEL_DELAY_MS: the load test's slow labelling",
    "services/store/worker.py": "TAGMILL_STORE_DELAY_MS: a slow disk, for tests",
}


@cache
def tracked() -> tuple[str, ...]:
    """The files of the repository, or, where there is none (an unpacked archive), all of the source folders."""
    if not (ROOT / ".git").exists():
        found = (path.relative_to(ROOT) for path in ROOT.rglob("*.py"))
        return tuple(str(path) for path in found if not path.parts[0].startswith(".venv"))
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
    return tuple(name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file())


def sources(*packages: str) -> Iterator[tuple[str, str]]:
    """Path and text of every tracked module."""
    for name in tracked():
        if name.endswith(".py") and name.split("/")[0] in packages:
            yield name, (ROOT / name).read_text()


@pytest.mark.parametrize("package", PACKAGES)
def test_the_packages_are_those_of_this_checkout(package: str) -> None:
    found = importlib.import_module(package).__file__
    assert found is not None
    assert Path(found).resolve() == ROOT / package / "__init__.py"


def test_no_module_is_longer_than_a_reader_can_hold() -> None:
    long = {name for name, text in sources(*PACKAGES) if len(text.splitlines()) > MAX_LINES}
    assert long == set(LONG_MODULES)


def test_every_module_says_what_it_is() -> None:
    assert [name for name, text in sources(*PACKAGES) if text and not ast.get_docstring(ast.parse(text))] == []


def test_services_sleep_only_where_it_is_named() -> None:
    found = {name for name, text in sources("services", "common") if re.search(r"\btime\.sleep\(|import sleep\b", text)}
    assert found == set(SLEEPERS)


def test_every_code_of_the_command_socket_has_words() -> None:
    codes = {code for command in COMMANDS.values() for code in command.errors} | set(GENERAL_ERRORS)
    assert codes
    assert codes <= set(WORDS), codes - set(WORDS)


def test_every_code_that_is_raised_has_words() -> None:
    """``code="..."`` of an error, wherever it stands."""
    raised = set()
    for name, text in sources("services", "common"):
        for node in ast.walk(ast.parse(text, name)):
            if isinstance(node, ast.Call):
                raised |= {
                    item.value.value
                    for item in node.keywords
                    if item.arg == "code" and isinstance(item.value, ast.Constant) and isinstance(item.value.value, str)
                }
    assert raised
    assert raised <= set(WORDS), raised - set(WORDS)


def test_topics_are_spelled_in_one_place() -> None:
    """No other module has a topic's name as a string, nor one that begins a topic on the wire."""
    wire = re.compile(rf"^({'|'.join(topic.name for topic in TOPICS)})/")
    made = []
    for name, text in sources("services", "common", "tools"):
        if name == "common/topics.py":
            continue
        for node in ast.walk(ast.parse(text, name)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Topic":
                made.append(f"{name}:{node.lineno} makes a topic")
            if isinstance(node, ast.Constant) and isinstance(node.value, (str, bytes)):
                spelled = node.value if isinstance(node.value, str) else node.value.decode("utf-8", "replace")
                if wire.match(spelled) and " " not in spelled:
                    made.append(f"{name}:{node.lineno} spells {spelled}")
    assert made == []


def test_no_path_of_a_machine_is_tracked() -> None:
    """Neither a home nor a work folder of whoever wrote it; /tmp only where the operating system means it."""
    machine = re.compile(rb"(?<![\w.\-/])/(?:home|root|work|Users|mnt|media)/[\w.-]+")
    found = []
    for name in tracked():
        data = (ROOT / name).read_bytes()
        if b"\0" in data[:4096]:
            continue
        for number, line in enumerate(data.splitlines(), 1):
            found += [f"{name}:{number}: {match.group().decode()}" for match in machine.finditer(line)]
    assert found == []


def test_no_secret_and_no_big_file_is_tracked() -> None:
    sizes = {name: (ROOT / name).stat().st_size for name in tracked()}
    assert {name: size for name, size in sizes.items() if size > 1_000_000} == {}
    assert [name for name in sizes if name.endswith((".key", ".key_secret", ".pem", ".sock", ".log", ".pid"))] == []
