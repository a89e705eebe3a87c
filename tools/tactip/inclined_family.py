"""Inclined specimens of any stiffness for many presses: tables at finite strain, else linear bodies.

A linear body that is not in a table is read between some that are solved.

A solved specimen takes ten seconds and more. Between solved ones approach, contact area and the skin's motion
at equal forces run smoothly over 1 / (1 + E / E0), as the head-on tables do, and are read by cubic splines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from palpate.core import Float, Probe, Specimen, ndarray
from palpate.mechanics.axisymmetric.tip_table import TURNING_PA
from palpate.sensors.tactip.inclined_press import Inclined, has_table, linear_inclined
from palpate.sensors.tactip.tactip_press import TipOnSpecimen, modulus_pa
from palpate.sensors.tactip.tactip_sensor import TacTip
from palpate.sensors.tactip.tactip_spec import TacTipSpec

NODES_N_M = (1.1e3, 1.4e3, 2.0e3, 3.1e3, 4.6e3, 7.6e3, math.inf)  # the references are among them
FORCES_N = np.linspace(0.0, np.cbrt(5.5), 28) ** 3
FINE = 4000  # approaches among which a force is looked up
STORED = ("approach_m", "lift_n", "touched_m2", "knots_rad", "moved_m")


@dataclass(frozen=True)
class InclinedFamily:
    """A tip on specimens of one tilt.

    Attributes:
        folder: where solved specimens are kept between runs; None for nowhere.
    """

    spec: TacTipSpec
    tilt_rad: float
    folder: Path | None = None
    nodes_n_m: tuple[float, ...] = NODES_N_M

    def solved(self, kappa_n_m: float) -> Inclined:
        """A specimen by the model itself, or what was kept of it."""
        pa = modulus_pa(self.spec.table, kappa_n_m)
        if self.folder is None:
            return linear_inclined(self.spec, pa, self.tilt_rad)
        name = (
            f"{self.spec.tip}-{self.spec.friction:g}-{math.degrees(self.tilt_rad):g}-{1e-3 * kappa_n_m:g}.npz"
        )
        path = self.folder / name
        if not path.exists():
            one = linear_inclined(self.spec, pa, self.tilt_rad)
            self.folder.mkdir(parents=True, exist_ok=True)
            np.savez(path, **{field: getattr(one, field) for field in STORED})
        with np.load(path) as arrays:
            return self._made(**arrays)

    def at(self, kappa_n_m: float) -> Inclined:
        """A specimen of any stiffness from the softest node on, read between the solved ones [N/m]."""
        columns = {name: spline(self._softness(kappa_n_m)) for name, spline in self._splines.items()}
        return self._made(lift_n=FORCES_N, knots_rad=self._knots_rad, **columns)

    def _made(self, **columns: Any) -> Inclined:
        # of the contact itself a press asks the tip's radius and the friction alone
        tip = SimpleNamespace(radius_m=self.spec.table.radius_m)
        contact: Any = SimpleNamespace(tip=tip, friction=self.spec.friction)
        return Inclined(contact, self.spec.inner_radius_m, **columns)

    def _softness(self, kappa_n_m: float) -> float:
        return 1.0 / (1.0 + modulus_pa(self.spec.table, kappa_n_m) / TURNING_PA)

    @cached_property
    def _knots_rad(self) -> Float[ndarray, " n"]:
        return self.solved(self.nodes_n_m[0]).knots_rad

    @cached_property
    def _splines(self) -> dict[str, CubicSpline]:
        columns = [_at_forces(self.solved(kappa)) for kappa in self.nodes_n_m]
        softness = np.array([self._softness(kappa) for kappa in self.nodes_n_m])
        order = np.argsort(softness)
        return {
            name: CubicSpline(softness[order], np.stack([one[name] for one in columns])[order])
            for name in columns[0]
        }


def _at_forces(one: Inclined) -> dict[str, ndarray]:
    """Its columns at the family's forces."""
    fine = np.linspace(0.0, one.deepest_m, FINE)
    approach = np.interp(np.cbrt(FORCES_N), np.cbrt(one.force_n(fine)), fine)
    moved = CubicSpline(one.approach_m, one.moved_m)(approach)
    return {"approach_m": approach, "touched_m2": one.area_m2(FORCES_N), "moved_m": moved}


@dataclass(frozen=True)
class InterpolatedTacTip(TacTip):
    """A TacTip that reads inclined specimens from families, by their tilt [rad]."""

    families: dict[float, InclinedFamily] = field(default_factory=dict, hash=False)
    _known: dict[tuple[float, float], TipOnSpecimen] = field(default_factory=dict, hash=False, compare=False)

    def tip_on(self, probe: Probe, specimen: Specimen | None) -> TipOnSpecimen:
        """As the TacTip's own; inclined ones that no table holds by the family of the nearest tilt."""
        kappa = math.inf if specimen is None or specimen.stiffness_n_m is None else specimen.stiffness_n_m
        if not probe.tilt_rad or has_table(self.spec, modulus_pa(self.spec.table, kappa), probe.tilt_rad):
            return super().tip_on(probe, specimen)
        tilt = min(self.families, key=lambda one: abs(one - probe.tilt_rad))
        if (tilt, kappa) not in self._known:
            self._known.clear()  # one specimen at a time: each holds megabytes
            self._known[tilt, kappa] = self.families[tilt].at(kappa)
        return self._known[tilt, kappa]
