"""What the words of a virtual TacTip's specimen mean: stiffness, modulus and radius, for files."""

from __future__ import annotations

import math
from typing import Any

from palpate.core import UNITS, Specimen
from palpate.recordings.exchange.press_folder import UNKNOWN_BODY, KnownBody
from palpate.sensors.tactip import TacTipSpec
from palpate.sensors.tactip.tactip_press import modulus_pa


def stiffness_of(words: str) -> float:
    """Return the stiffness named by words: inf for a rigid plate, NaN for none of the whole top [N/m]."""
    stiffness_n_m = Specimen.parse(bare(words)).stiffness_n_m
    return math.nan if stiffness_n_m is None else stiffness_n_m


def shape_of(spec: TacTipSpec, words: str) -> KnownBody:
    """Return E / (1 - nu^2) and radius of curvature named by words: inf for rigid, NaN for layers and viscous
    bodies.
    """
    specimen = Specimen.parse(bare(words))
    if specimen.thickness_m is not None or specimen.branches:
        return UNKNOWN_BODY
    E = specimen.youngs_modulus_pa
    if E is None:
        assert specimen.stiffness_n_m is not None
        E = modulus_pa(spec.table, specimen.stiffness_n_m)
    return KnownBody(E / (1 - spec.table.poisson_ratio**2), specimen.radius_m)


def bare(words: str) -> str:
    """Return a specimen's words without its tilt."""
    return words.partition("@")[0]


def body_shown(spec: TacTipSpec, words: str) -> dict[str, Any]:
    """Return the description of a specimen for JSON."""
    specimen, known = Specimen.parse(bare(words)), shape_of(spec, words)
    shown: dict[str, Any] = {"stiffness_N_per_mm": stiffness_shown(stiffness_of(words))}
    if specimen.youngs_modulus_pa is None:
        return shown
    shown |= {
        "shape": specimen.shape,
        "youngs_modulus_MPa": shown_in("MPa", specimen.youngs_modulus_pa),
        "poisson_ratio": spec.table.poisson_ratio,
        "reduced_modulus_MPa": shown_in("MPa", known.modulus_pa),
        "radius_mm": shown_in("mm", specimen.radius_m),
    }
    if specimen.thickness_m is not None:
        shown["thickness_mm"] = shown_in("mm", specimen.thickness_m)
    if specimen.branches:
        shown["relaxation"] = [{"modulus_MPa": shown_in("MPa", E), "time_s": t} for E, t in specimen.branches]
    return shown


def stiffness_shown(stiffness_n_m: float) -> float | str | None:
    """Return a stiffness in N/mm for JSON."""
    return shown_in("N_per_mm", stiffness_n_m)


def shown_in(unit: str, value: float) -> float | str | None:
    """Return a value in a unit for JSON, which has no infinity and no NaN."""
    if math.isnan(value):
        return None
    return "inf" if math.isinf(value) else UNITS[unit].from_si(value)
