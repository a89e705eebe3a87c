"""Parts of the view without a calibration: the tail of noise, what lies still, marks that move."""

from palpate.sensing.uncalibrated.mark_motion import (
    DotFollower,
    MarkKind,
    MarkMotion,
    PinFollower,
    follow_marks,
)
from palpate.sensing.uncalibrated.noise_tail import edge_share, tail_weights, upper_quantile
from palpate.sensing.uncalibrated.still_surround import StillSurround

__all__ = [
    "DotFollower", "MarkKind", "MarkMotion", "PinFollower", "StillSurround", "edge_share", "follow_marks",
    "tail_weights", "upper_quantile",
]  # fmt: skip
