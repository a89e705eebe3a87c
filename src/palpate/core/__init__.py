"""The nouns that every room speaks in, their units, their errors and the clock."""

from palpate.core.clock import Clock, ManualClock, MonotonicClock
from palpate.core.command import Command
from palpate.core.contact import Contact, Pose, Probe
from palpate.core.errors import (
    CertificateError,
    DeviceError,
    ExistsError,
    ImageError,
    InputError,
    LabelError,
    MissingExtraError,
    PalpateError,
    ProtocolError,
    RangeError,
    RecordingError,
    SafetyError,
    SplitError,
    StorageError,
    UnitError,
)
from palpate.core.frame import Frame
from palpate.core.protocols import (
    Camera,
    ForceSensor,
    HapticArm,
    Position,
    SoftnessDevice,
    Stage,
    Travel,
    Wrench,
)
from palpate.core.reading import Drift, Reading
from palpate.core.trial import Trial
from palpate.core.units import Unit, has_unit, split_column, unit

__all__ = [
    "Camera",
    "CertificateError",
    "Clock",
    "Command",
    "Contact",
    "DeviceError",
    "Drift",
    "ExistsError",
    "ForceSensor",
    "Frame",
    "HapticArm",
    "ImageError",
    "InputError",
    "LabelError",
    "ManualClock",
    "MissingExtraError",
    "MonotonicClock",
    "PalpateError",
    "Pose",
    "Position",
    "Probe",
    "ProtocolError",
    "RangeError",
    "Reading",
    "RecordingError",
    "SafetyError",
    "SoftnessDevice",
    "SplitError",
    "Stage",
    "StorageError",
    "Travel",
    "Trial",
    "Unit",
    "UnitError",
    "Wrench",
    "has_unit",
    "split_column",
    "unit",
]
