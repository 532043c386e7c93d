from __future__ import annotations

import json

import pytest

from tools.bench import render
from tools.bench.render import measure
from tools.cli import main


def test_every_variant_is_measured_on_the_same_frames():
    seen: dict[str, list[int]] = {"a": [], "b": []}
    costs = measure({name: frames.append for name, frames in seen.items()}, 5)
    path = [number * render.STEP for number in range(5)]
    assert seen["a"] == path + path, "once before it counts, once for the figures"
    assert seen["b"] == path
    assert [cost.variant for cost in costs] == ["a", "b"]
    assert all(0 <= cost.min_ms <= cost.median_ms <= cost.p95_ms for cost in costs)


def test_the_command_prints_one_document(capsys):
    assert main(["bench", "render", "--frames", "2", "--size", "160x120", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["size"] == [160, 120]
    assert len(document["variants"]) == 4


def test_a_size_that_is_none_is_wrong_usage(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["bench", "render", "--size", "big"])
    assert caught.value.code == 2
    assert "1280x720" in capsys.readouterr().err
