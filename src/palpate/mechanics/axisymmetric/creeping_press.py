"""A probe pressed on a viscous body: its elastic law at the modulus that the body's creep leaves it.

Elastic bodies in series touch by a law d(F, E), E of the one that creeps. Under a force F(t) it yields as

    C(t) = int_0^t J(t - s) dF(s),      J the creep compliance of its Prony series,

so that its modulus is in effect E_eff(t) = F(t) / C(t), and d(t) = d(F(t), E_eff(t)) is solved for F at every
sample. Of two of Hertz's bodies this is exact as long as the contact does not shrink (Lee and Radok's law,
the elastic one adding its own yield); it is exact in the limits of fast and of slow for any law. For others,
such as a tip at finite strain, it takes the contact's shape at F and E_eff for that of its whole history
(quasi-linear viscoelasticity).

References: E. H. Lee and J. R. M. Radok, J. Appl. Mech. 27 (1960) 438, doi:10.1115/1.3644020; Y. C. Fung,
Biomechanics (1993), ch. 7, doi:10.1007/978-1-4757-2257-4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import brentq

from palpate.core import Float, ndarray
from palpate.mechanics.viscoelastic import Prony

Series = Float[ndarray, " n"]
Approach = Callable[[float, float], float]
"""Approach [m] at a force [N] and a modulus [Pa]; it rises with the force."""


@dataclass
class CreepingPress:
    """A press as it goes on, sample by sample.

    Attributes:
        approach_m: the elastic law.
        body: what creeps.
        most_n: greatest force that the law knows; larger ones are taken for it [N].
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
        """The probe has left; the body begins anew."""
        self.force_n, self.modulus_pa = 0.0, self.body.instantaneous_pa
        self._held = np.zeros(len(self._rates))

    def to(self, depth_m: float, step_s: float) -> float:
        """Force at the next sample, a time later [N]."""
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


def creeping_press(
    approach_m: Approach, body: Prony, most_n: float, depth_m: Series, step_s: float
) -> tuple[Series, Series]:
    """Force [N] and modulus in effect [Pa] at samples of a depth, the first before contact or at it."""
    press = CreepingPress(approach_m, body, most_n)
    states = [(press.to(float(d), step_s), press.modulus_pa) for d in depth_m]
    force, modulus = np.array(states).T
    return force, modulus
