"""A viscoelastic skin as a Prony series, and the Kelvin-Voigt skin as a named baseline.

    E(t) = E_inf + sum_i E_i exp(-t / tau_i),

linear and with a constant Poisson's ratio. A history is straight between its samples; then each branch

    P_i(t) = int_0^t E_i exp(-(t - s)/tau_i) dx(s)

steps on exactly, P <- exp(-dt/tau) P + E (tau/dt) (1 - exp(-dt/tau)) dx, for steps of any length.

Reference: R. M. Christensen, Theory of Viscoelasticity (1982), ch. 1, Academic Press.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from palpate.core.errors import RangeError
from palpate.core.shapes import Float
from palpate.mechanics.hertz import positive

History = Float[ndarray, " n"]
Branches = Float[ndarray, "n m"]


@dataclass(frozen=True, slots=True)
class Prony:
    """A relaxation modulus.

    Attributes:
        equilibrium_pa: E_inf, which is left after a long time; positive [Pa].
        moduli_pa: E_i of the branches, positive [Pa].
        times_s: their relaxation times tau_i, positive [s].

    Raises:
        RangeError: a modulus or time is not positive, or they do not pair up.

    Example:
        >>> skin = Prony(0.2e6, (0.1e6,), (0.5,))
        >>> round(float(skin.relaxation(0.5)) / 1e6, 4)
        0.2368
    """

    equilibrium_pa: float
    moduli_pa: tuple[float, ...]
    times_s: tuple[float, ...]

    def __post_init__(self) -> None:
        positive("the equilibrium modulus", self.equilibrium_pa, "Pa")
        if len(self.moduli_pa) != len(self.times_s):
            raise RangeError(
                f"{len(self.moduli_pa)} moduli and {len(self.times_s)} relaxation times do not pair up; give "
                "one time "
                f"in s for each modulus in Pa"
            )
        for modulus, time in zip(self.moduli_pa, self.times_s, strict=True):
            positive("a branch's modulus", modulus, "Pa")
            positive("a relaxation time", time, "s")

    @property
    def instantaneous_pa(self) -> float:
        """E(0) = E_inf + sum E_i [Pa]."""
        return self.equilibrium_pa + math.fsum(self.moduli_pa)

    def relaxation(self, time_s: Float[ndarray, ...] | float) -> Float[ndarray, ...]:
        """E(t) [Pa] at times t >= 0 after a step of strain."""
        t = _not_negative("time", time_s, "s")
        return np.asarray(self.equilibrium_pa + np.exp(-t[..., None] / self._times) @ self._moduli)

    def compliance(self, time_s: Float[ndarray, ...] | float) -> Float[ndarray, ...]:
        """Creep J(t) [1/Pa]: strain at times t >= 0 after a step of stress, over that stress.

        The branches' stresses q obey q' = -(1 - E 1^T / E(0)) q / tau under a held load.
        """
        t = _not_negative("time", time_s, "s")
        E, E0 = self._moduli, self.instantaneous_pa
        root = np.sqrt(E / self._times)
        # with q = sqrt(E tau) v the rates are symmetric
        rates = np.diag(1 / self._times) - np.outer(root, root) / E0
        values, vectors = np.linalg.eigh(rates)
        start = vectors.T @ (np.sqrt(E / self._times) / E0)  # v = q / sqrt(E tau), q(0) = E / E0
        weights = vectors.T @ np.sqrt(E * self._times)
        held = np.exp(-t[..., None] * values) @ (weights * start)
        return np.asarray((1 - held) / self.equilibrium_pa)

    def storage(self, angular_frequency: float) -> float:
        """E'(omega) [Pa] under a sinusoidal strain at omega [rad/s]."""
        x2 = np.square(_positive_frequency(angular_frequency) * self._times)
        return self.equilibrium_pa + float(np.sum(self._moduli * x2 / (1 + x2)))

    def loss(self, angular_frequency: float) -> float:
        """E''(omega) [Pa] under a sinusoidal strain at omega [rad/s]."""
        x = _positive_frequency(angular_frequency) * self._times
        return float(np.sum(self._moduli * x / (1 + x**2)))

    def loss_per_cycle(self, angular_frequency: float, strain_amplitude: float) -> float:
        """Energy pi E'' eps0^2 lost per cycle and volume [J/m^3]."""
        _not_negative("strain amplitude", strain_amplitude, "(a ratio)")
        return math.pi * self.loss(angular_frequency) * strain_amplitude**2

    def branches(self, time_s: History, signal: History) -> Branches:
        """P_i(t_n) [Pa times the signal] of a signal that rests before its first sample.

        Raises:
            RangeError: the times do not increase, or something is not finite.
        """
        steps = _steps(time_s, signal)
        x = steps[:, None] / self._times
        fall = np.exp(-x)
        gain = self._moduli * -np.expm1(-x) / x * np.diff(signal)[:, None]
        held = np.zeros((len(time_s), len(self.times_s)))
        for n in range(len(steps)):
            held[n + 1] = fall[n] * held[n] + gain[n]
        return held

    def stress(self, time_s: History, strain: History) -> History:
        """Stress [Pa] under a history of strain that starts from rest at 0 strain.

        Raises:
            RangeError: the times do not increase, something is not finite, or the first strain is not 0.
        """
        if strain[0] != 0.0:
            raise RangeError(f"the first strain is {strain[0]:g}, not 0; start the history at rest")
        return np.asarray(self.equilibrium_pa * strain + self.branches(time_s, strain).sum(axis=1))

    @property
    def _moduli(self) -> Float[ndarray, " m"]:
        return np.array(self.moduli_pa, dtype=float)

    @property
    def _times(self) -> Float[ndarray, " m"]:
        return np.array(self.times_s, dtype=float)


@dataclass(frozen=True, slots=True)
class KelvinVoigt:
    """A spring beside a dashpot, sigma = E eps + eta eps': a baseline that others use.

    Its stress is infinite at a step of strain and does not relax while the strain is held; so it refuses
    histories with a step or a hold, which is how a rig presses. ``Prony`` has both.

    Attributes:
        modulus_pa: E, positive [Pa].
        viscosity_pa_s: eta, positive [Pa s].

    Raises:
        RangeError: a constant is not positive.
    """

    modulus_pa: float
    viscosity_pa_s: float

    def __post_init__(self) -> None:
        positive("the modulus", self.modulus_pa, "Pa")
        positive("the viscosity", self.viscosity_pa_s, "Pa s")

    def stress(self, time_s: History, strain: History) -> History:
        """Stress [Pa] under a smooth history of strain; the rate is taken from central differences.

        Raises:
            RangeError: the history has a step or a hold, or fewer than 3 samples, or is not finite.
        """
        _steps(time_s, strain)
        if len(time_s) < 3:
            raise RangeError(f"{len(time_s)} samples give no rate of strain; give 3 or more")
        if strain[0] != 0.0 or np.any(np.diff(strain) == 0.0):
            raise RangeError(
                "the history starts with a step or holds the strain; a Kelvin-Voigt skin has infinite stress "
                "at a step "
                "and does not relax in a hold: use a Prony series"
            )
        rate = np.gradient(strain, time_s, edge_order=2)
        return np.asarray(self.modulus_pa * strain + self.viscosity_pa_s * rate)


def _steps(time_s: History, signal: History) -> Float[ndarray, " steps"]:
    if len(time_s) != len(signal) or len(time_s) < 2:
        raise RangeError(
            f"{len(time_s)} times and {len(signal)} values are no history; give at least 2, one time a value"
        )
    steps = np.diff(time_s)
    if not (np.isfinite(time_s).all() and np.isfinite(signal).all() and (steps > 0).all()):
        raise RangeError(
            "the history holds a time that does not increase, or a value that is not finite; a jump in no "
            "time "
            "is no history: give it a duration in s"
        )
    return steps


def _not_negative(name: str, value: Float[ndarray, ...] | float, unit: str) -> Float[ndarray, ...]:
    values = np.asarray(value, dtype=float)
    if not (np.isfinite(values).all() and (values >= 0).all()):
        raise RangeError(f"{name} is {value} {unit}; give 0 or more {unit}")
    return values


def _positive_frequency(angular_frequency: float) -> float:
    positive("the angular frequency", angular_frequency, "rad/s")
    return angular_frequency
