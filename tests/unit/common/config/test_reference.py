"""The reference page and the camera registry say the same as the models."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pydantic import BaseModel

from common.config.dataset import DatasetConfig
from common.config.models import (
    DRIVER_OPTIONS,
    CameraConfig,
    InpaintConfig,
    MarkersConfig,
    NetworkConfig,
    ObjectConfig,
    PoseConfig,
    RecordConfig,
    RigConfig,
    RingConfig,
    SideConfig,
    WorkersConfig,
)
from common.ledgers import AutoLimits
from services.capture.cameras.registry import BUILT_IN

PAGE = (Path(__file__).resolve().parents[4] / "docs" / "reference" / "rig.md").read_text()
ALONE = (DatasetConfig, MarkersConfig, ObjectConfig, SideConfig, CameraConfig, NetworkConfig, *DRIVER_OPTIONS.values())
TOGETHER = {
    "workers": WorkersConfig,
    "ring": RingConfig,
    "record": RecordConfig,
    "record.auto": AutoLimits,
    "pose": PoseConfig,
    "inpaint": InpaintConfig,
}


def rows() -> dict[str, str]:
    """Key to its row, of all tables of the page."""
    found: dict[str, str] = {}
    for line in PAGE.splitlines():
        if line.startswith("| `"):
            for key in re.findall(r"`([a-z_.0-9]+)`", line.split("|")[1]):
                found[key] = line
    return found


@pytest.mark.parametrize("model", ALONE, ids=lambda model: model.__name__)
def test_every_key_has_its_row(model: type[BaseModel]) -> None:
    assert set(model.model_fields) <= set(rows())


def test_every_key_of_the_small_sections_has_its_row_with_its_default() -> None:
    table = rows()
    for section, model in TOGETHER.items():
        for name, field in model.model_fields.items():
            if not isinstance(field.default, BaseModel):  # else it is a section of its own
                assert f"| `{field.default}` |" in table[f"{section}.{name}"], name


def test_every_section_is_on_the_page() -> None:
    headings = " ".join(line for line in PAGE.splitlines() if line.startswith("#"))
    assert {name for name in RigConfig.model_fields if f"`{name}`" not in headings} == set()


def test_the_built_in_drivers_are_those_of_the_registry() -> None:
    assert set(BUILT_IN) == set(DRIVER_OPTIONS)
