"""Surface through a skin's marks, its strain, and what the strain tells of a touch."""

from palpate.estimators.surface_strain.ring_detection import ContactPeak, ShearRing, contact_peaks, find_rings
from palpate.estimators.surface_strain.spline_surface import SurfaceBasis, surface_basis
from palpate.estimators.surface_strain.strain_fields import (
    EdgeDirection,
    ShearMeasure,
    StrainFields,
    StrainMeter,
    axial_difference,
    edge_direction,
    on_plane,
    published_force_n,
    published_gamma,
    shear_from_pressure,
    shear_measure,
    strain_fields,
)
from palpate.estimators.surface_strain.traction_recovery import (
    PatternedSkin,
    RecoveredTraction,
    recover_traction,
)

__all__ = [
    "ContactPeak", "EdgeDirection", "PatternedSkin", "RecoveredTraction", "ShearMeasure", "ShearRing",
    "StrainFields", "StrainMeter", "SurfaceBasis", "axial_difference",
    "contact_peaks", "edge_direction", "find_rings", "on_plane", "published_force_n", "published_gamma",
    "recover_traction", "shear_from_pressure", "shear_measure", "strain_fields", "surface_basis",
]  # fmt: skip
