"""Optics: from stress and light to images.

Errors of this package: `InputError` for shapes that do not fit and values that are not finite; `RangeError`
for values outside their range.
"""

from palpate.optics.colour import Spectrum, assumed_camera, encode_srgb, spectral_to_linear
from palpate.optics.image_chain import (
    CameraResponse,
    LedStrip,
    backlight,
    develop,
    electrons,
    quantise,
    raw_codes,
    strip_light,
    uneven_light,
)
from palpate.optics.march import (
    AxisymmetricField,
    MarchedRays,
    Rays,
    Retarder,
    graded_slices,
    march,
    march_axisymmetric,
    march_colour,
    march_spectral,
)
from palpate.optics.polariscope import (
    ColumnRays,
    circular_amplitude,
    circular_dark_field,
    dark_field,
    linear_retarder,
    plane_amplitude,
    round_rim,
    single_retarder,
    through,
    with_leak,
)
from palpate.optics.stress_optic import StressOpticLaw, fringe_order, frozen_stress, stress_axis

__all__ = [
    "AxisymmetricField",
    "CameraResponse",
    "ColumnRays",
    "LedStrip",
    "MarchedRays",
    "Rays",
    "Retarder",
    "Spectrum",
    "StressOpticLaw",
    "assumed_camera",
    "backlight",
    "circular_amplitude",
    "circular_dark_field",
    "dark_field",
    "develop",
    "electrons",
    "encode_srgb",
    "fringe_order",
    "frozen_stress",
    "graded_slices",
    "linear_retarder",
    "march",
    "march_axisymmetric",
    "march_colour",
    "march_spectral",
    "plane_amplitude",
    "quantise",
    "raw_codes",
    "round_rim",
    "single_retarder",
    "spectral_to_linear",
    "stress_axis",
    "strip_light",
    "through",
    "uneven_light",
    "with_leak",
]
