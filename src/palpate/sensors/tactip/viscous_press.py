"""The tip on a viscous specimen: at every instant the elastic one with the effective modulus
(`creeping_press`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.optimize import brentq

from palpate.mechanics.axisymmetric.creeping_press import CreepingPress
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress, softness_share
from palpate.mechanics.viscoelastic import Prony
from palpate.sensors.tactip.tactip_press import HeadOn

MODULI = 24  # moduli of the interpolated elastic law
BEYOND = 0.02  # margin of the moduli


@dataclass(frozen=True)
class ViscousPress:
    """A tip on a viscous specimen, with the elastic contact by modulus [Pa] and the material's relaxation."""

    on: Callable[[float], HeadOn]
    body: Prony

    def approach_m(self, force_n: float, modulus_pa: float) -> float:
        """Approach on the elastic specimen [m]."""
        return float(self._law(softness_share(modulus_pa), np.cbrt(force_n))[0, 0])

    def modulus_pa(self, depth_m: float, force_n: float) -> float:
        """Effective modulus at a depth and force [Pa]."""
        stiff, soft = self._moduli[-1], self._moduli[0]
        if force_n <= 0.0 or depth_m <= self.approach_m(force_n, stiff):
            return float(stiff)
        if depth_m >= self.approach_m(force_n, soft):
            return float(soft)
        return float(
            np.exp(
                brentq(
                    lambda log: self.approach_m(force_n, float(np.exp(log))) - depth_m,
                    np.log(soft),
                    np.log(stiff),
                    xtol=1e-9,
                )
            )
        )

    def begun(self) -> CreepingPress:
        """A press before contact."""
        return CreepingPress(self.approach_m, self.body, self.most_n)

    def area_m2(self, force_n: float, modulus_pa: float) -> float:
        """Contact area with the elastic specimen [m^2]."""
        return float(self._area(softness_share(modulus_pa), np.cbrt(force_n))[0, 0])

    @property
    def most_n(self) -> float:
        """Maximum force of the tables [N]."""
        return float(self._presses[0].force_n[-1])

    @cached_property
    def _moduli(self) -> np.ndarray:
        low, high = self.body.equilibrium_pa, self.body.instantaneous_pa
        return np.geomspace(low, high * (1 + BEYOND), MODULI)

    @cached_property
    def _presses(self) -> list[HeadOnPress]:
        """From the stiffest to the softest."""
        return [self.on(float(E)).press for E in self._moduli[::-1]]

    @cached_property
    def _law(self) -> RectBivariateSpline:
        return self._over([press.approach_m for press in self._presses])

    @cached_property
    def _area(self) -> RectBivariateSpline:
        return self._over([press.area_m2 for press in self._presses])

    def _over(self, rows: list[np.ndarray]) -> RectBivariateSpline:
        share = [softness_share(float(E)) for E in self._moduli[::-1]]
        return RectBivariateSpline(share, np.cbrt(self._presses[0].force_n), np.stack(rows))
