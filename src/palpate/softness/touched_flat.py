"""A thick elastic flat as read by a tactile sensor: a modulus with its interval.

A stiffness of a cylinder between plates is converted, E = kappa h / (pi r^2) for sliding ends. Uncertainty is
drawn in 1 / E: half a Gaussian to either side, with the value as median and the interval's ends as quantiles.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.special import ndtri

from palpate.core import Float, InputError, RangeError, UnitError, ndarray, storage_errors
from palpate.core.parsing import parser
from palpate.softness.specimens import bonded_disc_n_m

Ends = Literal["bonded", "free"]
MAX_BYTES = 1 << 26
MIN_VALUE = 1e-6  # of a value in its unit, MPa or N/mm; its reciprocal is the greatest
MAX_COVERAGE = 0.999
CUES = {
    "modulus": ("modulus", "MPa", 1e6),
    "stiffness": ("stiffness", "N_per_mm", 1e3),
    "stiffness_both_cues": ("stiffness_both_cues", "N_per_mm", 1e3),
}
"""Quantity, unit and that unit in SI of what a reading is used for."""


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A cylinder between two plates, by which its stiffness becomes a modulus."""

    radius_m: float
    height_m: float
    poisson: float
    ends: Ends = "bonded"

    def __post_init__(self) -> None:
        if not (0 < self.radius_m < math.inf and 0 < self.height_m < math.inf and 0 <= self.poisson <= 0.5):
            raise RangeError(
                f"a cylinder of radius {1e3 * self.radius_m:g} mm, height {1e3 * self.height_m:g} mm and "
                f"Poisson's ratio {self.poisson:g}; lengths above 0 mm and a ratio of 0 to 0.5 are allowed",
                code="cylinder",
            )
        if self.ends not in ("bonded", "free"):
            raise InputError(f"ends {self.ends!r}; 'bonded' or 'free'")

    @property
    def n_m_of_1_pa(self) -> float:
        """Stiffness of a cylinder of 1 Pa [m]."""
        if self.ends == "free":
            return math.pi * self.radius_m**2 / self.height_m
        return bonded_disc_n_m(1.0, self.poisson, self.radius_m, self.height_m)

    def flat_pa(self, stiffness_n_m: float) -> float:
        """E / (1 - nu^2) of its material [Pa]."""
        return stiffness_n_m / self.n_m_of_1_pa / (1 - self.poisson**2)


@dataclass(frozen=True, slots=True)
class TouchedFlat:
    """Young's modulus over 1 - nu^2 of a flat, as read, with its interval (`high_pa` may be infinite)."""

    flat_pa: float
    low_pa: float
    high_pa: float
    coverage: float
    calibration: str
    words: str

    def __post_init__(self) -> None:
        if not 0 < self.low_pa <= self.flat_pa <= self.high_pa or not self.flat_pa < math.inf:
            raise RangeError(
                f"a flat of {self.flat_pa / 1e3:g} kPa in {self.low_pa / 1e3:g} to "
                f"{self.high_pa / 1e3:g} kPa; the value has to be finite, above 0 and inside its interval"
            )
        if not 0 < self.coverage < 1:
            raise RangeError(f"an interval of {self.coverage:g}; above 0 and below 1 are allowed")

    def at(self, share: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
        """Quantiles [Pa]: of 0.5 the value, of the interval's shares its ends; rigid beyond 1 / E = 0."""
        middle, z = 1 / self.flat_pa, ndtri((1 + self.coverage) / 2)
        softer, stiffer = (1 / self.low_pa - middle) / z, (middle - 1 / self.high_pa) / z
        q = ndtri(1 - np.asarray(share, float))  # a stiff one has little compliance
        compliance = middle + np.where(q > 0, softer, stiffer) * q
        with np.errstate(divide="ignore"):
            return np.asarray(1 / np.maximum(compliance, 0.0))

    def drawn(self, count: int, rng: np.random.Generator, beyond: float = 0.0) -> Float[ndarray, " n"]:
        """Moduli drawn, one in each of `count` even shares, none `beyond` a share of either end [Pa]."""
        share = (rng.permutation(count) + rng.uniform(size=count)) / count
        return self.at(np.clip(share, beyond, 1 - beyond))


@parser("touched flat", InputError)
def read_touched_flat(path: Path, use: str, cylinder: Cylinder | None = None) -> TouchedFlat:
    """Read a flat from readings.json or the ``--json`` output of `palpate read`."""
    if use not in CUES:
        raise InputError(f"a flat by {use!r}; there are {', '.join(CUES)}", code="flat-kind")
    quantity, unit, si = CUES[use]
    if (cylinder is None) != (use == "modulus"):
        raise InputError(
            "a stiffness needs its cylinder's radius, height and Poisson's ratio; a modulus none",
            code="cylinder-missing",
        )
    one = _reading(path, quantity, unit)
    ends = " to ".join("inf" if end is None else f"{end:.4g}" for end in (one["low"], one["high"]))
    words = (
        f"palpate compliance, calibration {one['calibration']}: {use} {one['value']:.4g} {unit} ({ends}, "
        f"{one['coverage']:.0%})"
    )

    def flat(value: float | None) -> float:
        if value is None:
            return math.inf
        return si * value if cylinder is None else cylinder.flat_pa(si * value)

    middle = flat(one["value"])
    if cylinder is not None:
        size = f"{1e3 * cylinder.radius_m:g} by {1e3 * cylinder.height_m:g} mm"
        E = middle * (1 - cylinder.poisson**2)
        words += f", of a {cylinder.ends} cylinder of {size}: {E / 1e3:.4g} kPa"
    low, high = (math.inf if one["low"] is None else flat(one["low"])), flat(one["high"])
    return TouchedFlat(middle, low, high, float(one["coverage"]), str(one["calibration"]), words)


def _reading(path: Path, quantity: str, unit: str) -> Mapping[str, Any]:
    """A valid reading of one quantity in a record of `palpate read`."""
    with storage_errors(path):
        if not path.is_file() or path.stat().st_size > MAX_BYTES:
            raise InputError(
                f"{path} is no record of `palpate read`; give its readings.json, or what --json printed"
            )
        raw = path.read_bytes()
    try:
        found = [one for one in json.loads(raw)["readings"] if one["quantity"] == quantity]
    except (ValueError, KeyError, TypeError, RecursionError) as e:
        raise InputError(f"{path} is no record of `palpate read`: it has no readings ({e})") from e
    if len(found) != 1:
        raise InputError(
            f"{path} has {len(found)} readings of {quantity}; one is needed, of a press read with a "
            "calibration (and for a modulus with positions)",
            code="reading-count",
        )
    one = found[0]
    keys = ("value", "low", "high", "unit", "coverage", "valid", "calibration")
    if missing := [key for key in keys if key not in one]:
        raise InputError(
            f"{path}: the reading of {quantity} has no {missing[0]!r}", code="reading-incomplete"
        )
    if one["unit"] != unit:
        raise UnitError(f"{path}: {quantity} is in {one['unit']!r}; {unit!r} is needed")
    if one["valid"] is not True:
        raise InputError(
            f"{path}: the {quantity} is not valid ({one.get('why')}); press anew", code="reading-invalid"
        )
    for key in ("value", "coverage"):
        if not _positive(one[key]):
            raise RangeError(f"{path}: {key} of {quantity} is {one[key]!r}; above 0 {unit} is allowed")
    if one["coverage"] > MAX_COVERAGE:
        raise RangeError(f"{path}: an interval of {one['coverage']}; at most {MAX_COVERAGE} is allowed")
    if not (isinstance(one["calibration"], str) and one["calibration"].isprintable()):
        raise InputError(f"{path}: the calibration of {quantity} is no name")
    if not all(end is None or _positive(end) for end in (one["low"], one["high"])):
        raise RangeError(f"{path}: {quantity} lies in {one['low']!r} to {one['high']!r} {unit}; above 0")
    return dict(one)


def _positive(value: object) -> bool:
    """Whether it is a number above 0, of a size that a modulus, stiffness or share may have."""
    return (
        isinstance(value, int | float) and not isinstance(value, bool) and MIN_VALUE < value < 1 / MIN_VALUE
    )
