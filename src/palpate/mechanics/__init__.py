"""Contact mechanics of probes on elastomers.

Errors of this package: `InputError` for a wrong kind, shape, or non-finite value; `RangeError` for a value
outside a law's or table's range, which the message names.
"""

from palpate.mechanics.axisymmetric.shape_table import (
    EdgeCorrection,
    SphereTable,
    edge_correction,
    press_finite_strain,
)
from palpate.mechanics.half_space.hertz import (
    contact_radius,
    depth_from_force,
    depth_from_radius,
    force_from_depth,
    greatest_depth,
    line_integrated_stress,
    peak_pressure,
    press,
    reduced_modulus,
    secondary_stress,
)

__all__ = [
    "EdgeCorrection",
    "SphereTable",
    "contact_radius",
    "depth_from_force",
    "depth_from_radius",
    "edge_correction",
    "force_from_depth",
    "greatest_depth",
    "line_integrated_stress",
    "peak_pressure",
    "press",
    "press_finite_strain",
    "reduced_modulus",
    "secondary_stress",
]
