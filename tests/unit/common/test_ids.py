"""Names that come from outside: a sample's name is a file name, never a path, and all of its parts can be read."""

from __future__ import annotations

import pytest

from common.ids import is_sample_name, sample_camera, sample_captured_at, sample_frame

NAME = "20260830T120431.120Z-cam-0.x-48211"


def test_a_sample_s_name_has_its_parts() -> None:
    assert is_sample_name(NAME)
    assert (sample_camera(NAME), sample_frame(NAME)) == ("cam-0.x", 48211)
    assert sample_captured_at(NAME) == "2026-08-30T12:04:31.120Z"


@pytest.mark.parametrize(
    "text",
    ["", "../x", f"../{NAME}", f"{NAME}/..", f"{NAME}\n", f"{NAME}\0", NAME.replace("cam", "../cam"), NAME + "9" * 5000,
     NAME.replace("48211", "٤٨"), NAME.replace("cam", "c" * 100)],
)  # fmt: skip
def test_nothing_else_is_one(text: str) -> None:
    assert not is_sample_name(text)
    for part in (sample_camera, sample_frame, sample_captured_at):
        with pytest.raises(ValueError, match="not a sample name"):
            part(text)
