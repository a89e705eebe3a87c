"""The nouns that every room speaks in, their units, their errors and the clock."""

from palpate.core.clock import Clock, ManualClock, MonotonicClock
from palpate.core.command import Command
from palpate.core.contact import Contact, Pose, Probe
from palpate.core.errors import (
    CertificateError,
    ExistsError,
    ImageError,
    InputError,
    LabelError,
    MissingExtraError,
    PalpateError,
    RangeError,
    RecordingError,
    SplitError,
    StorageError,
    UnitError,
)
from palpate.core.frame import Frame
from palpate.core.reading import Drift, Reading
from palpate.core.trial import Trial
from palpate.core.units import Unit, has_unit, split_column, unit

__all__ = [
    "CertificateError",
    "Clock",
    "Command",
    "Contact",
    "Drift",
    "ExistsError",
    "Frame",
    "ImageError",
    "InputError",
    "LabelError",
    "ManualClock",
    "MissingExtraError",
    "MonotonicClock",
    "PalpateError",
    "Pose",
    "Probe",
    "RangeError",
    "Reading",
    "RecordingError",
    "SplitError",
    "StorageError",
    "Trial",
    "Unit",
    "UnitError",
    "has_unit",
    "split_column",
    "unit",
]
