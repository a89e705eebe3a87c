"""An object from a tactile sensor's reading to a finger that feels it rendered, and what each stage loses."""

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
    "CueNoise",
    "CueTransmission",
    "StageJudgement",
    "Transmission",
    "felt_live",
    "judged",
    "object_file",
    "order_kept",
    "shared_peak_n",
    "transmission_record",
    "transmissions_record",
    "transmit",
]
