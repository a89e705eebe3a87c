"""Normal and lateral force and torque from recovered traction, with intervals for the assumptions.

The interval contains the marks' noise and the change by one standard deviation of each assumption: moduli,
friction, and support, added in squares.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from palpate.core import InputError, RangeError, Reading, Readings
from palpate.core.reading import NONE, Refusal
from palpate.estimators.surface_strain import PatternedSkin, RecoveredTraction, StrainFields, recover_traction

RANGE_N = (1.0, 8.0)  # over which recovery was measured; see the how-to
# relative standard deviation of force left by the closure; measured
FORM = {"frictionless": 0.02, "coulomb": 0.10, "bonded": 0.05}
LATERAL_FORM = 0.01  # of the normal force: what the coulomb closure leaves of a lateral one; measured
TORQUE_FORM_NM, TORQUE_FORM = 0.1e-3, 0.05  # what the coulomb closure leaves of a torque, and its share
MAX_TORQUE_NM = 10e-3  # to which that was measured
FINITE_STRAIN = 0.27  # relative force deviation over the greatest strain, by neo-Hookean layers
MAX_STRAIN = 0.4  # of the pattern, beyond which linear layers were not compared with finite strain
SEEN_MISFIT = 2.0  # standard errors; above it the marks move as this closure cannot make them move


@dataclass(frozen=True)
class SkinDoubt:
    """Relative standard deviations of what recovery assumes.

    Attributes:
        modulus: of all moduli together.
        friction: of Coulomb's coefficient.
        support: of the thickness of the most compliant layer.
    """

    modulus: float = 0.10
    friction: float = 0.10
    support: float = 0.05

    def __post_init__(self) -> None:
        if not all(0 <= share < 0.5 for share in (self.modulus, self.friction, self.support)):
            raise RangeError("doubts about a skin are shares from 0 to 0.5")


KNOWN = SkinDoubt(0.0, 0.0, 0.0)  # exactly known skin


@dataclass(frozen=True)
class ForceBudget:
    """Change of a frame's force where each assumption is one standard deviation off, as shares of it."""

    noise: float
    form: float
    strain: float
    modulus: float
    friction: float
    support: float

    @property
    def total(self) -> float:
        return math.hypot(self.noise, self.form, self.strain, self.skin)

    @property
    def skin(self) -> float:
        """The part that a better known skin would take away."""
        return math.hypot(self.modulus, self.friction, self.support)


def stiffer(skin: PatternedSkin, share: float) -> PatternedSkin:
    """Return the skin with all moduli higher by a ratio."""
    layers = tuple(
        replace(one, youngs_modulus_pa=one.youngs_modulus_pa * (1 + share)) for one in skin.stack.layers
    )
    return replace(skin, stack=replace(skin.stack, layers=layers))


def thicker_support(skin: PatternedSkin, share: float) -> PatternedSkin:
    """Return the skin with the most compliant layer below its pattern thicker by a ratio."""
    layers = list(skin.stack.layers)
    below = [i for i in range(skin.interface, len(layers)) if math.isfinite(layers[i].thickness_m)]
    if not below:
        raise InputError("no layer below the pattern has a thickness; the support is endless")
    soft = max(below, key=lambda i: layers[i].thickness_m / layers[i].youngs_modulus_pa)
    layers[soft] = replace(layers[soft], thickness_m=layers[soft].thickness_m * (1 + share))
    return replace(skin, stack=replace(skin.stack, layers=tuple(layers)))


def force_budget(
    fields: StrainFields, skin: PatternedSkin, doubt: SkinDoubt, closure: str, found: RecoveredTraction
) -> ForceBudget:
    """Return the change of a frame's force by each assumption.

    Args:
        found: traction with all as stated.
    """

    def change(other: PatternedSkin) -> float:
        again = recover_traction(fields, other, closure)
        return 0.0 if again is None else abs(again.force_n / found.force_n - 1)

    rubbed = replace(skin, friction=skin.friction * (1 + doubt.friction))
    return ForceBudget(
        found.force_error_n / found.force_n,
        FORM[closure],
        FINITE_STRAIN * greatest_strain(fields),
        doubt.modulus,  # exact: an image tells pressure over modulus
        change(rubbed) if closure == "coulomb" and doubt.friction else 0.0,
        change(thicker_support(skin, doubt.support)) if doubt.support else 0.0,
    )


def greatest_strain(fields: StrainFields) -> float:
    """Return the greatest principal strain of the pattern, stretch or compression."""
    principal = fields.principal()
    strains = np.abs(np.stack([principal.greatest, principal.least]))
    return float(np.nanmax(strains, initial=0.0))


def traction_readings(
    fields: StrainFields,
    skin: PatternedSkin,
    doubt: SkinDoubt | None = None,
    *,
    closure: str = "frictionless",
    coverage: float = 0.90,
    frame: str = "",
    time_s: float = 0.0,
) -> Readings:
    """Return force from the picture and a known skin, uncalibrated; lateral force where the closure has
    friction, and torque about the contact's normal, from x towards y, for Coulomb's.

    Args:
        fields: strain of a frame, of marks in m.
        doubt: None for 10 % of the moduli and friction, and 5 % of the support.
        closure: "frictionless", "coulomb", or "bonded".
        coverage: of the intervals, 0.5 to 0.99.
    """
    if not 0.5 <= coverage <= 0.99:
        raise InputError(f"a coverage of {coverage}; give 0.5 to 0.99")
    doubt = SkinDoubt() if doubt is None else doubt
    try:
        found, spread = recover_traction(fields, skin, closure), ""
    except RangeError as e:  # loads that reach over too much of the skin: a fault of the frame
        found, spread = None, str(e)
    name = f"traction, {closure}, moduli known to {100 * doubt.modulus:.3g} %"

    most_n = RANGE_N[1]
    ranges = dict.fromkeys(("force_x", "force_y"), (-most_n, most_n)) | {
        "force": RANGE_N,
        "torque": (-MAX_TORQUE_NM, MAX_TORQUE_NM),
    }

    def reading(quantity: str, unit: str, value: float, half: float, why: Refusal) -> Reading:
        return Reading(
            quantity=quantity,
            unit=unit,
            coverage=coverage,
            valid=not why,
            why=why.why,
            code=why.code,
            drift=None,
            calibration=name,
            frame=frame,
            time_s=time_s,
            value=value,
            low=value - half if quantity != "force" else max(value - half, 0.0),
            high=value + half,
            calibrated_range=ranges[quantity],
        )

    if spread:
        return Readings(
            {"force_N": reading("force", "N", math.nan, math.nan, Refusal("contact_too_large", spread))}
        )
    if found is None:
        return Readings(
            {"force_N": reading("force", "N", 0.0, RANGE_N[0], Refusal("no_contact", "no contact is seen"))}
        )
    budget = force_budget(fields, skin, doubt, closure, found)
    z = NormalDist().inv_cdf(0.5 + coverage / 2)
    why = _refusal(found, greatest_strain(fields))
    readings = {"force_N": reading("force", "N", found.force_n, z * budget.total * found.force_n, why)}
    if closure == "frictionless":
        return Readings(readings)
    for axis, value in zip("xy", found.lateral_n, strict=True):
        half = z * math.hypot(LATERAL_FORM * found.force_n, budget.skin * value, budget.strain * value)
        readings[f"force_{axis}_N"] = reading(f"force_{axis}", "N", value, half, why)
    if closure == "coulomb":
        torque = found.torque_nm
        half = z * math.hypot(
            TORQUE_FORM_NM, TORQUE_FORM * torque, budget.skin * torque, budget.strain * torque
        )
        beyond = Refusal("out_of_range", f"above {1e3 * MAX_TORQUE_NM:g} Nmm, where it was not measured")
        too_much = beyond if abs(torque) > MAX_TORQUE_NM else NONE
        readings["torque_Nm"] = reading("torque", "Nm", torque, half, why or too_much)
    return Readings(readings)


def _refusal(found: RecoveredTraction, strain: float) -> Refusal:
    low, high = RANGE_N
    if found.force_n < low:
        return Refusal("out_of_range", f"below {low:g} N, where the pattern hardly moves")
    if found.force_n > high:
        return Refusal("out_of_range", f"above {high:g} N, where recovery was not measured")
    if strain > MAX_STRAIN:
        return Refusal(
            "strain_beyond_linear",
            f"the pattern is strained by {100 * strain:.0f} %, and linear layers hold to "
            f"{100 * MAX_STRAIN:.0f} %; press less",
        )
    if found.misfit > SEEN_MISFIT:
        return Refusal(
            "misfit",
            f"the marks are {found.misfit:.1f} standard errors off what {found.closure} loads do to this "
            "skin; try another closure, or look at its layers",
        )
    return NONE
