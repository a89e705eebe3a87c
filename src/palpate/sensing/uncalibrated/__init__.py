"""Parts of the view without a calibration: the tail of noise, what lies still, marks that move."""

from palpate.sensing.uncalibrated.noise_tail import edge_share, tail_weights, upper_quantile
from palpate.sensing.uncalibrated.still_surround import StillSurround

__all__ = ["StillSurround", "edge_share", "tail_weights", "upper_quantile"]
