"""What a calibration leaves behind: its file, the views (so that one can go on), words and JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from common.boards import Board
from common.bounded import parse_json, read_bytes
from common.calibration import Miss, Outcome, Solution, View, view_from
from common.config.quality import Quality
from common.errors import DatasetError, RefusedError
from common.labels import CameraLabel
from tools.report.files import write_text

MOST_VIEWS_BYTES = 64 << 20
"""Of a file of kept views; a hundred views of a large board are 2 MiB."""


@dataclass(frozen=True)
class Places:
    """Where the files of one calibration go: ``file`` the calibration, beside it report and views."""

    file: Path

    @property
    def report(self) -> Path:
        """The page with tables and plots."""
        return self.file.with_suffix(".html")

    @property
    def views(self) -> Path:
        """The corners that were found."""
        return self.file.with_suffix(".views.json")

    @property
    def pictures(self) -> Path:
        """The folder of live pictures that gave views."""
        return self.file.with_name(f"{self.file.stem}-views")

    @property
    def previous(self) -> Path:
        """Where a calibration that is replaced goes."""
        return self.file.with_suffix(".previous.yaml")


def places(out: Path | None, camera: str, size: tuple[int, int] | None) -> Places:
    """``out`` names a file (.yaml), a folder, or nothing: then ``calibration/<camera>-<width>x<height>.yaml``."""
    if out is not None and out.suffix.lower() in (".yaml", ".yml"):
        return Places(out)
    name = camera if size is None else f"{camera}-{size[0]}x{size[1]}"
    # A name with dots would lose its end to with_suffix.
    return Places((out or Path("calibration")) / f"{name.replace('.', '_')}.yaml")


def label_of(solution: Solution, camera: str, serial: str | None) -> CameraLabel:
    """The calibration as a camera describes itself."""
    model = solution.camera
    return CameraLabel.model_validate(
        {
            "name": camera,
            "width": model.width,
            "height": model.height,
            "matrix": [[float(value) for value in row] for row in model.matrix],
            "distortion": [float(value) for value in model.distortion],
            "model": model.model,
            "intrinsics_from": "calibration",
            "serial": serial,
        }
    )


def quality_of(outcome: Outcome, solution: Solution, board: Board) -> Quality:
    """What the file says of its own quality."""
    sd = solution.uncertainty.sd
    return Quality(
        verdict=outcome.verdict.level,
        reasons=tuple(reason.words for reason in outcome.verdict.reasons),
        board=board_words(board),
        lens=solution.chosen.lens.name,
        views=len(solution.views),
        dropped=tuple(item.name for item in outcome.dropped if item.code == "outlier"),
        corners=solution.fit.count,
        rms_px=_short(solution.fit.rms),
        held_out_px=None if solution.chosen.held_out is None else _short(solution.chosen.held_out.rms),
        sd={name: _short(value) for name, value in zip(solution.chosen.lens.parameters, sd, strict=False)},
        focal_percent=_short(100 * solution.focal_share),
        projection_px=_short(solution.map.worst_px) if np.isfinite(solution.map.worst_px) else None,
        distance_mm=_short(solution.map.distance_mm),
        covered_percent=_short(100 * solution.spread.covered),
        tilts_span_deg=_short(solution.spread.tilt_range_deg),
        board_bent_mm=_short(solution.warp_mm),
    )


def board_words(board: Board) -> str:
    """A board in a few words."""
    sizes = {"square": board.square_mm, "marker": board.marker_mm, "gap": board.gap_mm}
    given = ", ".join(f"{name} {value:g} mm" for name, value in sizes.items() if value is not None)
    scale = "" if board.measured_scale == 1.0 else f", measured scale {board.measured_scale:g}"
    return f"{board.kind} {board.columns}x{board.rows}, {given}{scale}"


def save_views(path: Path, board: Board, views: Sequence[View]) -> None:
    """Write the views for another run. Raises RefusedError where that can't be done."""
    document = {"board": board.model_dump(mode="json"), "views": [view.document() for view in views]}
    try:
        write_text(json.dumps(document) + "\n", path)
    except DatasetError as error:
        raise RefusedError(f"{error.message}; choose another place with --out") from error


def load_views(path: Path) -> tuple[Board, list[View]]:
    """Board and views of a file that ``save_views`` wrote. Raises RefusedError."""
    try:
        document = parse_json(read_bytes(path, MOST_VIEWS_BYTES))
        return Board.model_validate(document["board"]), [view_from(one) for one in document["views"]]
    except OSError as error:
        raise RefusedError(f"{path} can't be read: {error.strerror}", code="no_views") from error
    except (ValueError, KeyError, TypeError) as error:
        raise RefusedError(f"{path} holds no views of tagmill calibrate: {error}", code="no_views") from error


def document(outcome: Outcome, board: Board, misses: Sequence[Miss], found: Places) -> dict[str, Any]:
    """All of it for programs."""
    verdict, solution = outcome.verdict, outcome.solution
    out: dict[str, Any] = {
        "ok": verdict.level != "not yet",
        "verdict": verdict.level,
        "sentence": verdict.sentence,
        "reasons": [{"code": item.code, "level": item.level, "words": item.words} for item in verdict.reasons],
        "board": board_words(board),
        "dropped": [{"name": item.name, "code": item.code, "reason": item.reason} for item in outcome.dropped],
        "missed": [{"name": item.name, "code": item.code, "reason": item.reason} for item in misses],
        "report": str(found.report),
    }
    if solution is None:
        return out
    fit, held = solution.fit, solution.chosen.held_out
    names = solution.chosen.lens.parameters
    out |= {
        "camera_matrix": solution.camera.matrix.tolist(),
        "distortion": solution.camera.distortion.tolist(),
        "quality": quality_of(outcome, solution, board).model_dump(mode="json"),
        "parameters": {
            name: {"value": float(value), "sd": float(sd)}
            for name, value, sd in zip(names, fit.theta, solution.uncertainty.sd, strict=False)
        },
        "design_effect": solution.uncertainty.design_effect,
        "models": [
            {
                "model": one.lens.name,
                "board": "flat" if one.flat else "warped",
                "rms_px": one.fit.rms,
                "held_out_px": None if one.held_out is None else one.held_out.rms,
                "fx": float(one.fit.theta[0]),
                "fault": one.fault,
                "chosen": one is solution.chosen,
            }
            for one in solution.candidates
        ],
        "views": [
            {
                "name": view.name,
                "corners": len(view.ids),
                "corners_dropped": solution.dropped_corners.get(view.name, 0),
                "rms_px": float(fit.view_rms[number]),
                "held_out_px": None if held is None else float(held.view_rms[number]),
                "tilt_deg": stance.tilt_deg,
                "distance_mm": stance.distance_mm,
                "edge_px": view.edge_px,
                "notes": list(view.notes),
            }
            for number, (view, stance) in enumerate(zip(solution.views, solution.spread.stances, strict=True))
        ],
    }
    return out


def _short(value: float) -> float:
    """Four digits that matter."""
    return float(f"{value:.4g}")
