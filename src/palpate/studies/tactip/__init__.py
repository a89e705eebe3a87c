"""The compliance report on the virtual TacTip: made again, its controls, and its equation (3) itself."""

from palpate.studies.tactip.controls import Row, compared, counted, cues, sensitivity
from palpate.studies.tactip.costs import Linear, Share, Truth, areas_by_friction, linear_error, shares, truth
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
