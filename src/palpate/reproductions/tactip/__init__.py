"""The compliance report on the virtual TacTip: made again, its controls, and its equation (3) itself."""

from palpate.reproductions.tactip.energy_contour import Contour, ContourGrowth, contour, told
from palpate.reproductions.tactip.model_errors import (
    Linear,
    Share,
    Truth,
    areas_by_friction,
    linear_error,
    shares,
    truth,
)
from palpate.reproductions.tactip.tactip_controls import Row, compared, counted, cues, sensitivity

__all__ = [
    "Contour",
    "ContourGrowth",
    "Linear",
    "Row",
    "Share",
    "Truth",
    "areas_by_friction",
    "compared",
    "contour",
    "counted",
    "cues",
    "linear_error",
    "sensitivity",
    "shares",
    "told",
    "truth",
]
