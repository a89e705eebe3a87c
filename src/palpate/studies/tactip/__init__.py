"""The compliance report on the virtual TacTip: made again, its controls, and its equation (3) itself."""

from palpate.studies.tactip.controls import (
    Linear,
    Row,
    Share,
    Truth,
    areas_by_friction,
    compared,
    counted,
    cues,
    linear_error,
    sensitivity,
    shares,
    truth,
)
from palpate.studies.tactip.energy import Contour, Told, contour, told

__all__ = [
    "Contour",
    "Linear",
    "Row",
    "Share",
    "Told",
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
