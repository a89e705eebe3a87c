"""What a person feels as softness, and devices that render it: characteristics, display, law."""

from palpate.softness.characteristics import (
    Characteristic,
    SoftObject,
    fingertip_object,
    hertz_object,
    polynomial,
    pressed_object,
)
from palpate.softness.display_parts import ConeDisplay
from palpate.softness.object_file import is_object_file, read_object
from palpate.softness.rendering_law import DisplayBounds, Limit, Mode, Rendered, RenderingLaw
from palpate.softness.specimens import (
    SpecimenClass,
    StackedSpecimen,
    series_spread,
    specimen_object,
    specimens,
)

__all__ = [
    "Characteristic",
    "ConeDisplay",
    "DisplayBounds",
    "Limit",
    "Mode",
    "Rendered",
    "RenderingLaw",
    "SoftObject",
    "SpecimenClass",
    "StackedSpecimen",
    "fingertip_object",
    "hertz_object",
    "is_object_file",
    "polynomial",
    "pressed_object",
    "read_object",
    "series_spread",
    "specimen_object",
    "specimens",
]  # fmt: skip
