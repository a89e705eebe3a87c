"""A Specimen: the body that is pressed, and the words that name one."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from palpate.core.errors import InputError

RIGID, UNTOLD = "rigid", "?"

SPHERE, LAYER, VISCOUS = "sphere", "layer", "viscous"
MODULUS, RADIUS, THICKNESS = "E_MPa", "R_mm", "h_mm"
NUMBERS: Mapping[str, tuple[str, ...]] = {
    SPHERE: (RADIUS, MODULUS),
    LAYER: (THICKNESS, MODULUS),
    VISCOUS: (MODULUS,),
}
EXAMPLES = {
    SPHERE: "ball=sphere:R_mm=20,E_MPa=0.3 (rigid without E_MPa)",
    LAYER: "sheet=layer:h_mm=2,E_MPa=0.1",
    VISCOUS: "slow=viscous:E_MPa=0.1,E1_MPa=0.05,tau1_s=1",
}
WORDS_OF_SPECIMENS = f"{RIGID}, NAME=STIFFNESS in N/mm as S1=7.6, or {', '.join(EXAMPLES.values())}"
MM, MPA = 1e-3, 1e6
_BRANCH = re.compile(r"(E|tau)([1-9])_(?:MPa|s)")


@dataclass(frozen=True, slots=True)
class Specimen:
    """A body that yields where it is touched; without one, the probe is rigid.

    Attributes:
        name: of the specimen, such as "S1".
        stiffness_n_m: force over deformation under a load spread over its whole top, inf for a rigid body;
            None where only the modulus is known [N/m].
        youngs_modulus_pa: of its material, of a viscous one after a long time, inf for a rigid sphere; None
            where only the stiffness is known [Pa].
        radius_m: radius of curvature of its top, inf for a flat one [m].
        thickness_m: of a layer bonded to a rigid base; None for another body [m].
        branches: of a viscous material's relaxation, (modulus [Pa], time [s]) each, beyond the modulus after
            a long time; empty for an elastic one.
    """

    name: str = ""
    stiffness_n_m: float | None = math.inf
    youngs_modulus_pa: float | None = None
    radius_m: float = math.inf
    thickness_m: float | None = None
    branches: tuple[tuple[float, float], ...] = ()

    @property
    def shape(self) -> str:
        """Kind of body in one word: rigid, cylinder, sphere or layer."""
        if math.isfinite(self.radius_m):
            return SPHERE
        if self.thickness_m is not None:
            return LAYER
        return RIGID if self.stiffness_n_m == math.inf and self.youngs_modulus_pa is None else "cylinder"

    @classmethod
    def parse(cls, words: str) -> Specimen:
        """A specimen from "rigid", NAME=STIFFNESS in N/mm, as in "S1=7.6", or NAME=KIND:NUMBERS.

        Kinds are a sphere of radius ``R_mm``, rigid without ``E_MPa``; a layer of thickness ``h_mm`` bonded
        to a rigid base; and a viscous cylinder. ``E_MPa`` is Young's modulus. ``E1_MPa`` and ``tau1_s``, and
        so on to 9, make any of them viscous: E(t) = E + sum E_i exp(-t / tau_i).

        A question mark at the end asks that whoever records it does not tell it on, as of a specimen
        that a calibration shall be tried on; it changes nothing here.
        """
        name, equals, value = words.removesuffix(UNTOLD).partition("=")
        kind, colon, numbers = value.partition(":")
        if name and colon:
            return _shaped(cls, words, name, kind, numbers)
        try:
            stiffness_n_m = 1e3 * float(value) if equals else math.inf
        except ValueError:
            stiffness_n_m = math.nan
        if not (name and stiffness_n_m > 0 and (equals or name == RIGID)):
            raise InputError(f"{words!r} is no specimen; give {WORDS_OF_SPECIMENS}", code="specimen-syntax")
        return cls(name, stiffness_n_m)


def _shaped(cls: type[Specimen], words: str, name: str, kind: str, numbers: str) -> Specimen:
    """A specimen of a kind."""
    if kind not in NUMBERS:
        raise InputError(
            f"{words!r}: there is no specimen {kind!r}; give {WORDS_OF_SPECIMENS}", code="specimen-kind"
        )
    given = _numbers(words, kind, numbers)
    needed = NUMBERS[kind][:1] if kind == SPHERE else NUMBERS[kind]
    missing = [key for key in needed if key not in given]
    if missing:
        raise InputError(
            f"{words!r}: a {kind} needs {' and '.join(missing)}, as in {EXAMPLES[kind]}",
            code="missing-parameter",
        )
    branches = _branches(words, given)
    if kind == VISCOUS and not branches:
        raise InputError(
            f"{words!r}: a viscous specimen needs E1_MPa and tau1_s, as in {EXAMPLES[VISCOUS]}",
            code="viscous-needs-term",
        )
    modulus = given.get(MODULUS, math.inf)
    if branches and not math.isfinite(modulus):
        raise InputError(
            f"{words!r}: a rigid sphere does not relax; give its E_MPa after a long time",
            code="rigid-relaxes",
        )
    return cls(
        name,
        None,
        MPA * modulus,
        MM * given[RADIUS] if kind == SPHERE else math.inf,
        MM * given[THICKNESS] if kind == LAYER else None,
        branches,
    )


def _numbers(words: str, kind: str, numbers: str) -> dict[str, float]:
    """Numbers of words such as "R_mm=20,E_MPa=0.3"."""
    allowed = NUMBERS[kind]
    given: dict[str, float] = {}
    for part in numbers.split(","):
        key, equals, text = part.partition("=")
        if key not in allowed and not _BRANCH.fullmatch(key):
            raise InputError(
                f"{words!r}: a {kind} has no {key!r}; it has {', '.join(allowed)}, and E1_MPa with tau1_s "
                "where it is viscous",
                code="unknown-parameter",
            )
        if key in given:
            raise InputError(f"{words!r} gives {key} twice", code="repeated-parameter")
        try:
            given[key] = float(text) if equals else math.nan
        except ValueError:
            given[key] = math.nan
        if not (given[key] > 0 and math.isfinite(given[key])):
            raise InputError(
                f"{words!r}: {key} of {text or 'nothing'}; give a finite number above 0 in that unit",
                code="number-range",
            )
    return given


def _branches(words: str, given: Mapping[str, float]) -> tuple[tuple[float, float], ...]:
    """Pairs of modulus [Pa] and time [s]."""
    found = {match for key in given if (match := _BRANCH.fullmatch(key))}
    moduli = {one[2]: MPA * given[one[0]] for one in found if one[1] == "E"}
    times = {one[2]: given[one[0]] for one in found if one[1] == "tau"}
    alone = sorted(moduli.keys() ^ times.keys())
    if alone:
        raise InputError(
            f"{words!r}: E{alone[0]}_MPa and tau{alone[0]}_s come together; give both",
            code="relaxation-terms",
        )
    return tuple((moduli[i], times[i]) for i in sorted(moduli))
