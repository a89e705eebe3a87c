"""TacTip units: constants fitted to a few presses of known force, forces read, and weight checks."""

from palpate.sensors.tactip.tip_copies.plate_presses import PlatePress, known_presses, pins_between
from palpate.sensors.tactip.tip_copies.tip_copy import COPY_TERMS, TipCopy, designed_tip
from palpate.sensors.tactip.tip_copies.tip_copy_fit import fit_tip_copy, read_plate_press
from palpate.sensors.tactip.tip_copies.tip_estimate import PlateReading, TipCopyFit

__all__ = [
    "COPY_TERMS",
    "PlatePress",
    "PlateReading",
    "TipCopy",
    "TipCopyFit",
    "designed_tip",
    "fit_tip_copy",
    "known_presses",
    "pins_between",
    "read_plate_press",
]
