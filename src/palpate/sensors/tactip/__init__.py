"""The TacTip: a gel-filled dome whose skin carries pins, seen from inside."""

from palpate.sensors.tactip.press import HeadOn, Specimen, Trial, pictured, trial
from palpate.sensors.tactip.spec import (
    PINS_127,
    PINS_331,
    ForceSensor,
    Pins,
    Seating,
    TacTipCamera,
    TacTipSpec,
    tactip,
)

__all__ = [
    "PINS_127",
    "PINS_331",
    "ForceSensor",
    "HeadOn",
    "Pins",
    "Seating",
    "Specimen",
    "TacTipCamera",
    "TacTipSpec",
    "Trial",
    "pictured",
    "tactip",
    "trial",
]
