"""Modulus and radius by references of known ones: the surface through them, and where it may not be read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palpate.core import Float, Int, ndarray
from palpate.core.refusal import ReasonCode, Refusal
from palpate.estimators.compliance.shape_surface import Roundness, ShapeSurface, fit_shape_surface
from palpate.recordings.exchange.press_folder import KnownBody

BEYOND = 0.05  # of the span of references in s and c, beyond which a place is not read
OUTSIDE_MODULUS = "{:.3g} MPa is outside of the references' moduli, {:.3g} MPa to rigid"
OUTSIDE_RADIUS = "a radius of {:.3g} mm is outside of the references', {:.3g} mm to flat"
HOLLOW = (
    "the object shows itself hollow, by a radius of {:.3g} mm the other way: no such reference was pressed, "
    "and a layer on a hard base shows itself so too"
)


def fit_shapes(
    bodies: Sequence[KnownBody], rows: Sequence[Float[ndarray, " d"]], which: Int[ndarray, " t"]
) -> ShapeSurface | None:
    """Fit the surface of modulus and radius through references; None where no sphere is among them.

    Args:
        rows: of every trial, motion of pins at every level and the approach from the first level to others.
        which: reference of every trial.
    """
    known = [i for i, body in enumerate(bodies) if body.known]
    if not any(np.isfinite(bodies[i].radius_m) for i in known):
        return None
    stacked = np.stack(rows)
    return fit_shape_surface(
        [bodies[i].modulus_pa for i in known],
        [bodies[i].radius_m for i in known],
        [stacked[which == i] for i in known],
    )


def moduli_pa(surface: ShapeSurface) -> tuple[float, float]:
    """Least and greatest finite modulus of the references [Pa]."""
    finite = surface.modulus_pa[np.isfinite(surface.modulus_pa)]
    return float(finite.min()), float(finite.max())


def errors_between(surface: ShapeSurface) -> dict[str, float]:
    """Errors by which the other references tell each one between them, for files."""
    of_modulus, of_c = surface.between
    return {"modulus": of_modulus, "curvature_per_m": of_c / surface.turning_m}


def shape_reasons(surface: ShapeSurface, found: Roundness) -> list[Refusal]:
    """Why neither modulus nor radius is valid."""
    s, c = found.place
    least, _ = moduli_pa(surface)
    smallest, why = float(surface.radius_m.min()), []
    if s > (1 + BEYOND) / (1 + least / surface.turning_pa):
        why.append(OUTSIDE_MODULUS.format(1e-6 * found.modulus_pa[0], 1e-6 * least))
    if c > (1 + BEYOND) * surface.turning_m / smallest:
        why.append(OUTSIDE_RADIUS.format(1e3 * found.radius_m[0], 1e3 * smallest))
    if c + found.half[1] < 0:
        why.append(HOLLOW.format(-1e3 * surface.turning_m / c))
    return [Refusal(ReasonCode.SHAPE_OUTSIDE_RANGE, text) for text in why]
