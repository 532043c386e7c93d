"""Camera calibration as pure functions: a board's view in a picture, how views differ, a fit that judges itself."""

from common.calibration.detect import BoardFinder, Miss
from common.calibration.diversity import Spread, Stance, distinct, is_new, nearest, spread, stance
from common.calibration.engine import ALL_MODELS, Outcome, Solution, calibrate
from common.calibration.guidance import Guidance
from common.calibration.guide import Guide
from common.calibration.verdict import Reason, Verdict, judge_views
from common.calibration.views import View, view_from
from common.calibration.wishes import Wish, tilt_counts, wishes

__all__ = [
    "ALL_MODELS", "BoardFinder", "Guidance", "Guide", "Miss", "Outcome", "Reason", "Solution", "Spread", "Stance",
    "Verdict", "View", "Wish", "calibrate", "distinct", "is_new", "judge_views", "nearest", "spread", "stance",
    "tilt_counts", "view_from", "wishes",
]  # fmt: skip
