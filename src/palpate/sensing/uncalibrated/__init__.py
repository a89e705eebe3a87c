"""Parts of the view without a calibration: noise and brightness, what changed, what lies still, marks."""

from palpate.sensing.uncalibrated.brightness_gain import BrightnessGain
from palpate.sensing.uncalibrated.changed_parts import (
    box_of,
    disc,
    large_parts,
    outlines_of,
    strongest_part,
)
from palpate.sensing.uncalibrated.mark_motion import (
    DotFollower,
    MarkKind,
    MarkMotion,
    MarksApart,
    PinFollower,
    follow_marks,
)
from palpate.sensing.uncalibrated.noise_tail import edge_share, tail_weights, upper_quantile
from palpate.sensing.uncalibrated.still_surround import StillSurround

__all__ = [
    "BrightnessGain", "DotFollower", "MarkKind", "MarkMotion", "MarksApart", "PinFollower", "StillSurround",
    "box_of", "disc", "edge_share", "follow_marks", "large_parts", "outlines_of", "strongest_part",
    "tail_weights", "upper_quantile",
]  # fmt: skip
