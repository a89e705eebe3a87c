"""Probe and pose on an elastomer: what they do to it."""

from palpate.mechanics.hertz import (
    contact_radius,
    depth_from_force,
    depth_from_radius,
    force_from_depth,
    greatest_depth,
    peak_pressure,
    press,
    reduced_modulus,
)
from palpate.mechanics.hertz_field import secondary_stress
from palpate.mechanics.line_integral import line_integrated_stress
from palpate.mechanics.press_table import PressTable, press_finite_strain
from palpate.mechanics.rim import RimEffect, rim_effect

__all__ = [
    "PressTable",
    "RimEffect",
    "contact_radius",
    "depth_from_force",
    "depth_from_radius",
    "force_from_depth",
    "greatest_depth",
    "line_integrated_stress",
    "peak_pressure",
    "press",
    "press_finite_strain",
    "reduced_modulus",
    "rim_effect",
    "secondary_stress",
]
