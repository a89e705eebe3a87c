"""The TacTip: a gel-filled dome whose skin carries pins, seen from inside.

Errors: `InputError` for a wrong kind, name, or non-finite value; `RangeError` for a value outside a design's
or law's range; `ImageError` for a picture that does not fit; `LabelError` for a wrong label or table.
"""

from palpate.sensors.tactip.posed_tip import skin_places_m, untouched_area_m2
from palpate.sensors.tactip.tactip_press import HeadOn, TipOnSpecimen, pictured
from palpate.sensors.tactip.tactip_spec import (
    PINS_127,
    PINS_331,
    ForceSensorSpec,
    PinLayout,
    SeatingSpread,
    TacTipCamera,
    TacTipSpec,
    fitted_tactip,
    tactip,
)

__all__ = [
    "PINS_127",
    "PINS_331",
    "ForceSensorSpec",
    "HeadOn",
    "PinLayout",
    "SeatingSpread",
    "TacTipCamera",
    "TacTipSpec",
    "TipOnSpecimen",
    "fitted_tactip",
    "pictured",
    "skin_places_m",
    "tactip",
    "untouched_area_m2",
]
