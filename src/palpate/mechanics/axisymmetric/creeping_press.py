"""A probe pressed on a viscoelastic body, by its elastic law at an effective modulus.

With the elastic law d(F, E) and the creep C(t) = int_0^t J(t - s) dF(s), E_eff(t) = F(t) / C(t), and
d(t) = d(F(t), E_eff(t)) is solved for F at every sample: exact for Hertz contacts that do not shrink (Lee and
Radok), and quasi-linear viscoelasticity otherwise.

References: E. H. Lee and J. R. M. Radok, J. Appl. Mech. 27 (1960) 438, doi:10.1115/1.3644020; Y. C. Fung,
Biomechanics (1993), ch. 7, doi:10.1007/978-1-4757-2257-4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import brentq

from palpate.mechanics.viscoelastic import Prony

Approach = Callable[[float, float], float]
"""Approach [m] by force [N] and modulus [Pa], rising with the force."""


@dataclass
class CreepingPress:
    """A press, sample by sample.

    Attributes:
        approach_m: Elastic law.
        body: Viscoelastic body.
        most_n: Maximum force of the law, to which larger ones are limited [N].
    """

    approach_m: Approach
    body: Prony
    most_n: float
    force_n: float = field(default=0.0, init=False)
    modulus_pa: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self._weights, self._rates = self.body.retardation()
        self.leave()

    def leave(self) -> None:
        """Reset after the probe has left."""
        self.force_n, self.modulus_pa = 0.0, self.body.instantaneous_pa
        self._held = np.zeros(len(self._rates))

    def to(self, depth_m: float, step_s: float) -> float:
        """Force at the next sample [N]."""
        if depth_m <= 0.0:
            self.leave()
            return 0.0
        x = self._rates * step_s
        faded, gain = np.exp(-x) * self._held, -np.expm1(-x) / x

        def yielded(force_n: float) -> float:
            held = faded + gain * (force_n - self.force_n)
            return force_n / self.body.equilibrium_pa - float(self._weights @ held)

        def short(force_n: float) -> float:
            return self.approach_m(force_n, force_n / yielded(force_n)) - depth_m

        low = 1e-9 * self.most_n
        if short(low) >= 0.0:
            force = low
        elif short(self.most_n) <= 0.0:
            force = self.most_n
        else:
            force = float(brentq(short, low, self.most_n, xtol=1e-9, rtol=1e-12))
        self._held = faded + gain * (force - self.force_n)
        self.modulus_pa, self.force_n = force / yielded(force), force
        return force
