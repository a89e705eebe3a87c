"""An object from a tactile reading to a finger that feels it rendered, with the loss of each stage."""

from palpate.softness.transmission.judged_stages import CueNoise, StageJudgement, judged
from palpate.softness.transmission.transmission_record import (
    felt_live,
    object_file,
    order_kept,
    transmission_record,
    transmissions_record,
)
from palpate.softness.transmission.transmitted_cues import (
    CueTransmission,
    Transmission,
    shared_peak_n,
    transmit,
)

__all__ = [
    "CueNoise", "CueTransmission", "StageJudgement", "Transmission", "felt_live", "judged", "object_file",
    "order_kept", "shared_peak_n", "transmission_record", "transmissions_record", "transmit",
]  # fmt: skip
