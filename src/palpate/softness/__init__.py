"""What a person feels as softness, and devices that render it: characteristics, display, law."""

from palpate.softness.characteristics import Characteristic, SoftObject, hertz_object, polynomial
from palpate.softness.cone_display import ConeDisplay
from palpate.softness.object_file import read_object
from palpate.softness.rendering_law import DisplayBounds, Limit, Mode, Rendered, RenderingLaw

__all__ = [
    "Characteristic", "ConeDisplay", "DisplayBounds", "Limit", "Mode", "Rendered", "RenderingLaw",
    "SoftObject", "hertz_object", "polynomial", "read_object",
]  # fmt: skip
