"""Viscoelastic laws against brute-force quadrature."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

from oracles import Oracle, relative
from palpate.mechanics.viscoelastic import Prony, press, ting

R, NU, TOP = 5e-3, 0.49, 1e-3
SKIN = Prony(0.1e6, (0.15e6, 0.05e6), (0.5, 0.05))


def _triangle(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """In for a second, out for a second."""
    t = np.linspace(0, 2, samples)
    return t, TOP * (1 - np.abs(1 - t))


def _relaxed(t: float) -> float:
    return 0.1e6 + 0.15e6 * math.exp(-t / 0.5) + 0.05e6 * math.exp(-t / 0.05)


def _force(t: float) -> float:
    """Ting's two integrals, by adaptive quadrature and a root."""
    widest = t
    if t > 1:
        back = quad(lambda s: _relaxed(t - s), 1, t)[0]

        def balance(t1: float) -> float:
            return quad(lambda s: _relaxed(t - s), t1, 1)[0] - back

        if balance(0.0) <= 0:
            return 0.0
        widest = brentq(balance, 0, 1, xtol=1e-12)
    near = max(widest - 0.1, widest / 2)
    pushed = quad(lambda s: _relaxed(t - s) * 1.5 * math.sqrt(s), 0, widest, points=[near], limit=200)[0]
    return 4 / 3 * math.sqrt(R) / (1 - NU**2) * TOP**1.5 * pushed


def loop() -> float:
    """Force and the loop's area of a press in and out."""
    t, d = _triangle(81)
    forces = np.array([_force(v) for v in t])
    found = ting(t, d, R, SKIN, NU)
    # By quadrature too: a trapezoid over the samples is 6e-4 off, as the force between them is no line.
    area = TOP * (quad(_force, 0, 1)[0] - quad(_force, 1, 2, limit=200)[0])
    return max(abs(found.loss_j / area - 1), relative(found.force_n, forces))


def elements() -> float:
    """The general law, element by element, against Ting's, over the greatest force."""
    t, d = _triangle(201)
    one, other = ting(t, d, R, SKIN, NU), press(t, d, R, SKIN, NU)
    return relative(other.force_n, one.force_n)


def cycle() -> float:
    """Energy lost in a steady cycle, from stress and strain stepped through it, against pi E'' eps^2."""
    omega, strain = 4.0, 0.02
    t = np.linspace(0, 12 * 2 * np.pi / omega, 60_001)
    e = strain * np.sin(omega * t)
    last = t >= t[-1] - 2 * np.pi / omega * (1 + 1e-9)
    lost = float(np.trapezoid(SKIN.stress(t, e)[last], e[last]))
    return abs(lost / SKIN.loss_per_cycle(omega, strain) - 1)


def inverse() -> float:
    """Relaxation and creep undo each other: the integral of E(t - s) J(s) is t."""
    errors = []
    for t in (0.02, 0.3, 2.0):
        whole = quad(
            lambda s, t=t: _relaxed(t - s) * float(SKIN.compliance(s)), 0, t, points=[t / 10], limit=200
        )[0]
        errors.append(abs(whole / t - 1))
    return max(errors)


ORACLES = (
    Oracle("Press in and out: force, area of the loop", "Ting's integrals by quadrature", 2e-5, loop),
    Oracle("Any history, element by element: force", "Ting's law for one press", 1e-4, elements),
    Oracle("Energy lost in a cycle", "πE″ε²", 1e-4, cycle),
    Oracle("Creep", "the inverse of relaxation, by quadrature", 1e-8, inverse),
)
