"""Stress and light to images."""

from palpate.optics.colour import Spectrum, assumed_camera, encode_srgb, spectral_to_linear
from palpate.optics.march import Retarder, graded_slices, march
from palpate.optics.noise import electrons, electrons_exact, illumination, quantise
from palpate.optics.polariscope import dark_field, single_retarder, with_leak
from palpate.optics.stress_optic import StressOpticLaw, fringe_order, stress_axis

__all__ = [
    "Retarder",
    "Spectrum",
    "StressOpticLaw",
    "assumed_camera",
    "dark_field",
    "electrons",
    "electrons_exact",
    "encode_srgb",
    "fringe_order",
    "graded_slices",
    "illumination",
    "march",
    "quantise",
    "single_retarder",
    "spectral_to_linear",
    "stress_axis",
    "with_leak",
]
