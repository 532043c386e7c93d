"""The generated pages are up to date, and every code of the command socket has its words."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from common.commands import COMMANDS, GENERAL_ERRORS
from common.words import WORDS, words_for
from tools.docs import ROOT, pages

_ANSWER_THROUGH = ("services/control", "services/label", "services/store", "common", "tools")
"""Where the codes come from that control, or a sub-command, can show."""


@pytest.mark.parametrize("name", sorted(pages()))
def test_generated_pages_are_up_to_date(name: str) -> None:
    path = ROOT / name
    assert path.exists(), "run `make docs`"
    assert path.read_text(encoding="utf-8") == pages()[name], "run `make docs`"


def test_every_code_of_the_table_has_words() -> None:
    codes = {*GENERAL_ERRORS, *(code for row in COMMANDS.values() for code in row.errors)}
    assert codes - set(WORDS) == set()


def test_every_code_in_the_source_has_words() -> None:
    codes = set().union(*(_codes(path) for folder in _ANSWER_THROUGH for path in (ROOT / folder).rglob("*.py")))
    assert {"no_object", "disk_full", "session_busy", "timeout", "no_camera"} <= codes, "the scan sees too little"
    assert codes - set(WORDS) == set()


def test_words_are_for_people() -> None:
    for code, words in WORDS.items():
        assert words.title.endswith("."), code
        assert not re.search(
            r"\b(error|invalid|exception|null|timeout)\b", f"{words.title} {words.what_to_do}", re.I
        ), code


def test_an_unknown_code_is_shown_as_it_is() -> None:
    assert words_for("gone_fishing").title == "Gone fishing."


def _codes(path: Path) -> set[str]:
    """Codes written as ``code="..."`` or ``code = NAME`` in calls and classes, or as keys of a table of reasons."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    named = {
        target.id: node.value.value
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    found: list[ast.expr | None] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            found += [word.value for word in node.keywords if word.arg == "code"]
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            if node.targets[0].id == "code":
                found.append(node.value)
            elif node.targets[0].id in {"_REASONS", "SENTENCES"} and isinstance(node.value, ast.Dict):
                found += node.value.keys
    texts = {item.value for item in found if isinstance(item, ast.Constant)}
    return {text for text in texts if isinstance(text, str)} | {
        named[item.id] for item in found if isinstance(item, ast.Name) and item.id in named
    }
