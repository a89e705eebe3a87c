"""NUSense: a soft pad whose two-colored tiles show a fisheye camera how the pad is sheared.

Errors: `InputError` for a wrong kind, name, or non-finite value; `RangeError` for a value outside a design's
or law's range; `ImageError` for a picture that does not fit.
"""

from palpate.sensors.nusense.nusense_spec import (
    NuSenseSpec,
    PadLayers,
    PadLight,
    Tear,
    TilePattern,
    fabricated,
)

__all__ = ["NuSenseSpec", "PadLayers", "PadLight", "Tear", "TilePattern", "fabricated"]
