"""What a calibration leaves behind: its file with its quality, and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from common.boards import Board
from common.calibration import Miss, Outcome, Solution
from common.calibration.kept import Places, board_words
from common.config.quality import Quality
from common.labels import CameraLabel


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
