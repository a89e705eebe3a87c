"""What other than touch could have told the labels: order, time, the rim, other labels, copies."""

from palpate.calibration.confounds.confound_audit import AuditedRows, ConfoundAudit, audit_confounds
from palpate.calibration.confounds.confound_findings import Finding
from palpate.calibration.confounds.deciding_pixels import DecidingPixels, deciding_pixels

__all__ = [
    "AuditedRows", "ConfoundAudit", "DecidingPixels", "Finding", "audit_confounds", "deciding_pixels",
]  # fmt: skip
