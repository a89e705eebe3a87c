"""The nouns that every room speaks in: shapes, units, errors, the clock, files."""

from palpate.core.class_reading import ClassReading
from palpate.core.clock import NS_PER_S, Clock, ManualClock, MonotonicClock
from palpate.core.contact import (
    FRESH,
    RIGID,
    UNTOLD,
    Contact,
    EarlierPress,
    Pose,
    PressHistory,
    Probe,
    Specimen,
)
from palpate.core.device_protocols import Camera, ForceSensor, FrameSource, Position, Stage, Travel, Wrench
from palpate.core.errors import (
    CertificateError,
    ColumnError,
    DeviceError,
    ExistsError,
    HardwareStopError,
    ImageError,
    InputError,
    LabelError,
    MissingExtraError,
    PalpateError,
    PluginError,
    ProtocolError,
    RangeError,
    RecordingError,
    SafetyError,
    SplitError,
    StorageError,
    UnitError,
)
from palpate.core.files import (
    Closing,
    PathText,
    is_hidden,
    lock,
    new_file,
    new_folder,
    refuse_existing,
    sha256_of,
    sha256_of_all,
    storage_errors,
    sync,
)
from palpate.core.frame import Frame
from palpate.core.long_work import Progress, ProgressCount, in_parallel, silent
from palpate.core.outline import Outline
from palpate.core.reading import (
    AlignedBox,
    CircularReading,
    Drift,
    Ellipsoid,
    FieldReading,
    GridAxis,
    MeasurementResult,
    Reading,
    Readings,
    SetReading,
    VectorReading,
)
from palpate.core.sensor import (
    DEFAULT_SENSOR,
    SEATED,
    SENSORS,
    Box,
    ForceLaw,
    ImageAxes,
    Seating,
    Sensor,
    force_law,
    is_rigid,
    own_plans_of,
    untouched,
)
from palpate.core.shapes import (
    Bool,
    Complex,
    Complex64,
    Field,
    Float,
    Float16,
    Float32,
    Image,
    Images,
    Indices,
    Int,
    Mask,
    Shaped,
    Tensor,
    UInt8,
    UInt16,
    Values,
    ndarray,
)
from palpate.core.units import (
    UNITS,
    Unit,
    half_width_text,
    has_unit,
    interval_text,
    rounded,
    split_column,
    unit,
)

__all__ = [
    "DEFAULT_SENSOR", "FRESH", "NS_PER_S", "RIGID", "SEATED", "SENSORS", "UNITS", "UNTOLD", "AlignedBox",
    "Bool", "Box", "Camera", "CertificateError", "CircularReading", "ClassReading", "Clock", "Closing",
    "ColumnError", "Complex", "Complex64", "Contact", "DeviceError", "Drift", "EarlierPress", "Ellipsoid",
    "ExistsError",
    "Field", "FieldReading", "Float", "Float16", "Float32", "ForceLaw", "ForceSensor", "Frame",
    "FrameSource", "GridAxis", "HardwareStopError", "Image", "ImageAxes", "ImageError", "Images", "Indices", "InputError", "Int",
    "LabelError", "ManualClock", "Mask", "MeasurementResult", "MissingExtraError", "MonotonicClock",
    "Outline", "PalpateError", "PathText", "PluginError", "Pose", "Position", "PressHistory", "Probe",
    "Progress", "ProgressCount", "ProtocolError", "RangeError", "Reading", "Readings", "RecordingError",
    "SafetyError", "Seating", "Sensor", "SetReading", "Shaped", "Specimen", "SplitError", "Stage",
    "StorageError", "Tensor", "Travel", "UInt8", "UInt16", "Unit", "UnitError", "Values", "VectorReading",
    "Wrench", "force_law", "half_width_text", "has_unit", "in_parallel", "interval_text", "is_hidden",
    "is_rigid", "lock", "ndarray", "new_file", "new_folder", "own_plans_of", "refuse_existing", "rounded",
    "sha256_of", "sha256_of_all", "silent", "split_column", "storage_errors", "sync", "unit", "untouched",
]  # fmt: skip
