"""What a page may ask of a calibration: boards by name or description, kept views, and no path from outside."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi import FastAPI

from common.boards import Board, write_board
from common.calibration.kept import places, save_views
from common.config import Rig, load_rig
from common.errors import RefusedError
from common.labels import CameraLabel
from common.messages import CameraState
from services.console import calibration_api
from services.console.calibrating import Start, arguments, boards_beside, kept
from services.console.calibrator import in_short
from tests.support.asgi import Answered, ask
from tests.unit.common.calibration.synthetic import Camera

BOARD = Board(kind="charuco", columns=8, rows=6, square_mm=30, marker_mm=22, family="5x5_250", legacy=True)
CHESS = {"kind": "chessboard", "columns": 9, "rows": 6, "square_mm": 25}
RIG = "cameras:\n  cam0: {driver: synthetic, width: 1280, height: 720, fps: 15}\n"


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    (tmp_path / "rig.yaml").write_text(RIG)
    return load_rig(tmp_path / "rig.yaml")


class Calibrator:
    """Notes what it is told; refuses as the real one does while another calibration runs."""

    def __init__(self) -> None:
        self.report: Path | None = None
        self.started: list[tuple[str, list[str]]] = []
        self.busy = False

    async def start(self, camera: str, words: list[str]) -> None:
        if self.busy:
            raise RefusedError("cam0 is being calibrated already", code="busy")
        self.started.append((camera, words))

    async def order(self, order: str) -> None:
        raise RefusedError(f"no calibration is taking views, so no {order}", code="no_calibration")

    def data(self) -> dict[str, Any]:
        return {"phase": "idle"}


class Home:
    def __init__(self, rig: Rig) -> None:
        self.rig, self.calibrator = rig, Calibrator()

    def camera_state(self, name: str) -> CameraState | None:
        label = CameraLabel(
            name=name, width=1280, height=720, matrix=((1, 0, 0), (0, 1, 0), (0, 0, 1)), distortion=(),
            intrinsics_from="guess",
        )  # fmt: skip
        return CameraState.model_construct(camera=label)

    def ask(self, method: str, path: str, **fields: Any) -> Answered:
        app = FastAPI()
        app.include_router(calibration_api.router(self))  # type: ignore[arg-type]
        body = json.dumps(fields).encode() if method == "POST" else b""
        return ask(app, method, f"/api/calibration{path}", body, content_type="application/json")  # type: ignore[arg-type]


@pytest.fixture
def home(rig: Rig) -> Home:
    return Home(rig)


def test_a_board_is_described_by_options_of_the_command(home: Home) -> None:
    described = BOARD.model_dump(exclude_none=True, exclude={"first_id", "border_bits", "measured_scale"})
    assert home.ask("POST", "/start", camera="cam0", board=described).status == 200
    (camera, words) = home.calibrator.started[-1]
    assert camera == "cam0"
    assert words == [
        "--rig", str(home.rig.path), "--board", "charuco", "--size", "8x6", "--legacy",
        "--square-mm", "30.0", "--marker-mm", "22.0", "--family", "5x5_250",
    ]  # fmt: skip
    text = "kind: chessboard\ncolumns: 9\nrows: 6\nsquare_mm: 25\nmeasured_scale: 0.987\n"
    assert home.ask("POST", "/start", camera="cam0", board_text=text).status == 200
    assert home.calibrator.started[-1][1][-2:] == ["--measured-scale", "0.987"]


def test_boards_beside_the_rig_are_found_by_name(home: Home, tmp_path: Path) -> None:
    write_board(tmp_path / "board.yaml", BOARD)
    (tmp_path / "calibration").mkdir()
    write_board(tmp_path / "calibration" / "other.yaml", Board.model_validate(CHESS))
    (tmp_path / "broken.yaml").write_text("kind: [")
    assert boards_beside(home.rig).keys() == {"board.yaml", "calibration/other.yaml"}
    listed = home.ask("GET", "").json["boards"]
    assert [item["file"] for item in listed] == ["board.yaml", "calibration/other.yaml"]
    assert home.ask("POST", "/start", camera="cam0", board_file="board.yaml").status == 200
    assert home.calibrator.started[-1][1][-2:] == ["--board", str(tmp_path / "board.yaml")]


@pytest.mark.parametrize(
    "fields",
    [
        {"board_file": "../../etc/passwd"},
        {"board_file": "/etc/passwd"},
        {"board": CHESS | {"kind": "charuco", "marker_mm": 20, "family": "/etc/passwd"}},
        {"board": CHESS | {"kind": "charuco", "marker_mm": 20, "family": "secret.yml"}},
        {"board_text": "kind: charuco\ncolumns: 8\nrows: 6\nsquare_mm: 30\nmarker_mm: 22\nfamily: ../a.yaml\n"},
        {"board_text": "kind: charuco\nfamily: [a]\n"},
    ],
)
def test_nothing_from_outside_becomes_a_path(home: Home, tmp_path: Path, fields: dict[str, Any]) -> None:
    (tmp_path / "secret.yml").write_text("nmarkers: 1")
    answer = home.ask("POST", "/start", camera="cam0", **fields)
    assert answer.status in {409, 422}
    assert answer.json["error"]["code"] in {"no_board", "bad_request"}
    assert not home.calibrator.started


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({}, "which board?"),
        ({"board": CHESS, "go_on": True}, "which board?"),
        ({"board": CHESS | {"columns": 1}}, "too small"),
        ({"board": {"kind": "chessboard"}}, "columns"),
        ({"board_text": "kind: ["}, "the board"),
        ({"board_text": "x" * 20_000}, "board_text"),
        ({"board": CHESS, "extra": 1}, "extra"),
        ({"go_on": True}, "no views of cam0 are kept"),
    ],
)
def test_a_mistake_is_told_in_words(home: Home, fields: dict[str, Any], words: str) -> None:
    answer = home.ask("POST", "/start", camera="cam0", **fields)
    assert answer.status in {409, 422}
    assert words in answer.json["error"]["message"]
    assert not home.calibrator.started


def test_a_camera_must_be_the_rigs(home: Home) -> None:
    answer = home.ask("POST", "/start", camera="cam7", board=CHESS)
    assert answer.status == 422
    assert "cam0" in answer.json["error"]["message"]
    assert home.ask("POST", "/start", camera="../cam0", board=CHESS).status == 422


def test_one_at_a_time_and_orders_only_while_one_runs(home: Home) -> None:
    home.calibrator.busy = True
    assert home.ask("POST", "/start", camera="cam0", board=CHESS).json["error"]["code"] == "busy"
    for order in ("take", "drop", "finish"):
        answer = home.ask("POST", f"/{order}")
        assert (answer.status, answer.json["error"]["code"]) == (409, "no_calibration")


def test_kept_views_are_offered_until_a_calibration_came_of_them(rig: Rig) -> None:
    found = places(rig.folder / "calibration", "cam0", (1280, 720))
    assert kept(found) is None
    save_views(found.views, Board.model_validate(CHESS), Camera().good_views(np.random.default_rng(1), 4))
    told = kept(found)
    assert told is not None
    assert (told["views"], told["unfinished"], told["board"]) == (4, True, "chessboard 9x6, square 25 mm")
    words = arguments(Start(camera="cam0", go_on=True), rig, found)
    assert words[-3:] == ["--live", "--views", str(found.views)]
    found.file.write_text("width: 1280")
    told = kept(found)
    assert told is not None
    assert not told["unfinished"]
    found.views.write_text("{")
    assert kept(found) is None


def test_the_report_is_a_file_to_keep(home: Home, tmp_path: Path) -> None:
    assert home.ask("GET", "/report").status == 404
    home.calibrator.report = tmp_path / "cam0-1280x720.html"
    assert home.ask("GET", "/report").status == 404
    home.calibrator.report.write_text("<p>good")
    answer = home.ask("GET", "/report")
    assert answer.body == b"<p>good"
    assert answer.headers["content-disposition"] == 'attachment; filename="cam0-1280x720.html"'


def test_a_result_without_a_fit_has_no_figures() -> None:
    found = {
        "verdict": "not yet",
        "sentence": "s",
        "reasons": [{"words": "few"}],
        "dropped": [],
        "notes": [],
        "file": None,
    }
    told = in_short(found)
    assert (told["verdict"], told["reasons"], told["views"], told["file"]) == ("not yet", ["few"], None, None)
