"""One tree of errors. A message says what was asked, what is allowed, the unit and what to do."""

import re


class PalpateError(Exception):
    """Root of everything palpate raises on purpose.

    Attributes:
        code: machine-readable reason, lower-case words joined by hyphens, such as ``"onnx-operator"``. The
            default is the code of the class, such as ``"certificate"`` of a `CertificateError`.

    Example:
        >>> InputError("depth_mm is -1. Give 0 to 5 mm.").code
        'input'
        >>> InputError("depth_mm is -1. Give 0 to 5 mm.", code="depth-range").code
        'depth-range'
    """

    code: str = "palpate"

    def __init__(self, *args: object, code: str = "") -> None:
        super().__init__(*args)
        if code:
            self.code = code

    def __init_subclass__(cls, **kwargs: object) -> None:
        super().__init_subclass__(**kwargs)
        if "code" not in cls.__dict__:
            cls.code = re.sub(r"(?<!^)(?=[A-Z])", "-", cls.__name__.removesuffix("Error")).lower()


class InputError(PalpateError, ValueError):
    """What was given cannot be used."""


class UnitError(InputError):
    """A column or quantity carries no unit, or one that is not known."""


class RangeError(InputError):
    """A value lies outside the range where a law or a device is valid."""


class MaterialStrainError(RangeError):
    """A material is strained beyond the range of its law."""

    code = "material-strain"


class ScanEdgeError(RangeError):
    """The best value lies at the end of the searched range."""

    code = "scan-edge"


class ImageError(InputError):
    """An image is missing, damaged, too large, or of a kind that is not read."""


class MisfitError(ImageError):
    """A model does not fit an image within its noise."""

    code = "misfit"


class ColumnError(InputError, KeyError):
    """There is no reading of that name or quantity."""

    __str__ = Exception.__str__  # a KeyError shows its message in quotes


class PluginError(InputError):
    """A plug-in cannot be imported, takes a name that exists, or breaks a law of its kind."""


class LabelError(InputError):
    """A table of labels is damaged or does not fit its images."""


class SplitError(InputError):
    """The data cannot carry the split that was asked for."""


class ExistsError(PalpateError, FileExistsError):
    """The path exists already, and nothing is ever overwritten."""


class StorageError(PalpateError, OSError):
    """The disk is full, or refused a read or a write."""


class RecordingError(PalpateError):
    """A run is missing, damaged beyond its readable part, or not a run."""


class CertificateError(PalpateError):
    """A calibration's card, model and guard do not belong together."""


class DeviceError(PalpateError):
    """A device is gone, does not answer in time, or refuses."""


class HardwareStopError(DeviceError):
    """An input of a device's own, such as a door or hold switch, stopped it, and not this computer."""


class PositionUnknownError(DeviceError):
    """The position of a stage is not known, so that nothing may move towards the skin.

    Attributes:
        code: Machine-readable reason, such as "marker-lost".
    """

    code = "position-lost"


class ProtocolError(DeviceError):
    """Bytes came that are not the device's language."""


class SafetyError(PalpateError):
    """A guard refused a motion, or stopped it."""


class MissingExtraError(PalpateError, ImportError):
    """An optional package is needed for what was asked."""
