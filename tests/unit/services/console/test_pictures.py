"""A sample's files for the gallery: by name, decoded where a browser can't, kept small."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from common.errors import DatasetError
from services.console.catalog import Catalog
from services.console.pictures import THUMB_WIDTH, Pictures
from tests.support.samples import label_for

SAMPLE = label_for(1)
PICTURE = np.full((48, 64, 3), (10, 200, 90), np.uint8)
DEPTH = np.full((48, 64), 4000, np.uint16)


@pytest.fixture
def session(tmp_path: Path) -> Path:
    for kind, pixels in (("rgb", PICTURE), ("depth", DEPTH)):
        (tmp_path / kind).mkdir()
        cv2.imwrite(str(tmp_path / kind / f"{kind}_{SAMPLE.sample}.png"), pixels)
    (tmp_path / "label").mkdir()
    (tmp_path / "label" / f"label_{SAMPLE.sample}.json").write_text(SAMPLE.model_dump_json(by_alias=True))
    (tmp_path.parent / "secret.png").write_bytes(b"secret")
    return tmp_path


@pytest.fixture
def pictures() -> Iterator[Pictures]:
    made = Pictures()
    yield made
    made.close()
    made.close()


def item(**files: str | None) -> dict[str, Any]:
    named = {kind: f"{kind}/{kind}_{SAMPLE.sample}.png" for kind in ("rgb", "depth")}
    return {"name": SAMPLE.sample, "files": named | files}


def read(pictures: Pictures, session: Path, what: Any, **files: str | None) -> Any:
    return asyncio.run(pictures.read(session, item(**files), what, binned=False))


def decoded(data: bytes) -> np.ndarray:
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture


def test_pictures_are_sent_as_stored_and_depth_in_colours(pictures: Pictures, session: Path) -> None:
    rgb = read(pictures, session, "rgb")
    assert rgb.media_type == "image/png"
    assert (decoded(rgb.data) == PICTURE).all()
    depth = read(pictures, session, "depth")
    assert depth.media_type == "image/jpeg"
    assert decoded(depth.data).shape == (48, 64, 3)
    assert read(pictures, session, "label").media_type == "application/json"


def test_a_thumbnail_is_made_once(pictures: Pictures, session: Path) -> None:
    first = read(pictures, session, "thumb")
    assert decoded(first.data).shape == (240, THUMB_WIDTH, 3)
    (session / "rgb" / f"rgb_{SAMPLE.sample}.png").unlink()
    assert read(pictures, session, "thumb").data == first.data
    with pytest.raises(DatasetError, match="is missing"):
        read(pictures, session, "rgb")


@pytest.mark.parametrize("path", ["../secret.png", "/etc/passwd", "rgb/../../secret.png"])
def test_a_path_that_leads_out_of_the_session_is_refused(pictures: Pictures, session: Path, path: str) -> None:
    with pytest.raises(DatasetError):
        read(pictures, session, "rgb", rgb=path)


def test_what_is_not_there_or_damaged_is_told_in_words(pictures: Pictures, session: Path) -> None:
    with pytest.raises(DatasetError, match="has no original picture"):
        read(pictures, session, "original")
    (session / "rgb" / f"rgb_{SAMPLE.sample}.png").write_bytes(b"no picture")
    with pytest.raises(DatasetError, match="damaged"):
        read(pictures, session, "thumb")
    (session / "label" / f"label_{SAMPLE.sample}.json").write_text("{}")
    with pytest.raises(DatasetError, match="what the depth picture counts in"):
        read(pictures, session, "depth")


def test_the_mean_size_is_that_of_the_newest_samples(pictures: Pictures, session: Path) -> None:
    async def nobody(fields: dict[str, Any], limit_s: float) -> dict[str, Any]:
        raise AssertionError((fields, limit_s))

    catalog = Catalog(nobody)
    assert asyncio.run(pictures.mean_bytes(session, catalog)) is None
    catalog.stored = {SAMPLE.sample: item(), "gone": {"name": "gone", "files": {"rgb": "rgb/gone.png"}}}
    catalog.version += 1
    size = sum((session / path).stat().st_size for path in item()["files"].values())
    assert asyncio.run(pictures.mean_bytes(session, catalog)) == size
