"""NUSense: a soft pad whose two-colored tiles show a fisheye camera how the pad is sheared."""

from palpate.sensors.nusense.nusense_spec import (
    NuSenseSpec,
    PadLayers,
    PadLight,
    Tear,
    TilePattern,
    fabricated,
)

__all__ = ["NuSenseSpec", "PadLayers", "PadLight", "Tear", "TilePattern", "fabricated"]
