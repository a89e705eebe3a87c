"""The nouns that every room speaks in, their units, their errors and the clock."""

from palpate.core.clock import Clock, ManualClock, MonotonicClock
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
    Position,
    Stage,
    Travel,
    Wrench,
)
from palpate.core.reading import Drift, Reading
from palpate.core.units import Unit, has_unit, split_column, unit

__all__ = [
    "Camera",
    "CertificateError",
    "Clock",
    "Contact",
    "DeviceError",
    "Drift",
    "ExistsError",
    "ForceSensor",
    "Frame",
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
    "SplitError",
    "Stage",
    "StorageError",
    "Travel",
    "Unit",
    "UnitError",
    "Wrench",
    "has_unit",
    "split_column",
    "unit",
]
