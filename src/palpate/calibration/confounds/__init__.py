"""What other than touch could predict the labels: order, time, the rim, other labels."""

from palpate.calibration.confounds.confound_audit import audit_confounds
from palpate.calibration.confounds.skin_region import DecidingPixels, deciding_pixels

__all__ = ["DecidingPixels", "audit_confounds", "deciding_pixels"]
