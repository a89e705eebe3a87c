"""The compliance report on the virtual TacTip: reproduced, its controls, and its equation (3) itself."""

from palpate.reproductions.tactip.energy_contour import Contour, ContourGrowth, contour, contour_growths
from palpate.reproductions.tactip.model_errors import (
    Linear,
    Share,
    Truth,
    areas_by_friction,
    linear_error,
    shares,
    truth,
)
from palpate.reproductions.tactip.tactip_controls import Row, compared, cues, equation_12, sensitivity

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
    "contour_growths",
    "cues",
    "equation_12",
    "linear_error",
    "sensitivity",
    "shares",
    "truth",
]
