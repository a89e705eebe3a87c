"""Viscoelastic membranes as Prony series, and the indentation of one by a rigid sphere (Ting's law).

    E(t) = E_inf + sum_i E_i exp(-t / tau_i),    P_i(t) = int_0^t E_i exp(-(t - s)/tau_i) dx(s),

with constant Poisson's ratio; for histories that are linear between samples P_i is updated exactly. Under a
sphere, with K = 4 sqrt(R) / (3 (1 - nu^2)), a depth d(t) that rises and then falls gives

    F = K int_0^{t1} E(t - s) d(d^{3/2})/ds ds,      a = sqrt(R d(t1)),

with t1 = t during loading, and int_{t1}^t E(t - s) d'(s) ds = 0 during unloading. Any other history is
integrated over elements 0 < x < a_max (method of dimensionality reduction),

    F = 2 int chi dx,    chi (1 - nu^2) = int E(t - s) du(x, s) >= 0,    u = d - x^2/R under load.

Valid to a/R = 0.5, for small strain, without friction or adhesion.

References: R. M. Christensen, Theory of Viscoelasticity (1982), ch. 1, Academic Press;
T. C. T. Ting, J. Appl. Mech. 33 (1966) 845, doi:10.1115/1.3625192;
V. L. Popov, E. Willert, M. Heß, Facta Univ. Mech. Eng. 16 (2018) 99, doi:10.22190/FUME180327013P.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palpate.core import Bool, Float, Int, RangeError, ndarray
from palpate.mechanics.half_space.hertz import contact_radius, positive, reduced_modulus

History = Float[ndarray, " n"]
Branches = Float[ndarray, "n m"]


@dataclass(frozen=True, slots=True)
class Prony:
    """A relaxation modulus.

    Attributes:
        equilibrium_pa: E_inf, positive [Pa].
        moduli_pa: E_i, positive [Pa].
        times_s: tau_i, positive [s].

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
                "one time in s for each modulus in Pa"
            )
        for modulus, time in zip(self.moduli_pa, self.times_s, strict=True):
            positive("a branch's modulus", modulus, "Pa")
            positive("a relaxation time", time, "s")

    @property
    def instantaneous_pa(self) -> float:
        """E(0) [Pa]."""
        return self.equilibrium_pa + math.fsum(self.moduli_pa)

    def relaxation(self, time_s: Float[ndarray, ...] | float) -> Float[ndarray, ...]:
        """E(t) [Pa] at times t >= 0."""
        t = _not_negative("time", time_s, "s")
        return np.asarray(self.equilibrium_pa + np.exp(-t[..., None] / self._times) @ self._moduli)

    def compliance(self, time_s: Float[ndarray, ...] | float) -> Float[ndarray, ...]:
        """Creep compliance J(t) [1/Pa] at times t >= 0."""
        t = _not_negative("time", time_s, "s")
        weights, rates = self.retardation()
        return np.asarray(1 / self.equilibrium_pa - np.exp(-t[..., None] * rates) @ weights)

    def retardation(self) -> tuple[Float[ndarray, " m"], Float[ndarray, " m"]]:
        """Weights [1/Pa] and rates [1/s] of J(t) = 1/E_inf - sum w_i exp(-r_i t)."""
        E, E0 = self._moduli, self.instantaneous_pa
        root = np.sqrt(E / self._times)
        # with q = sqrt(E tau) v the rates are symmetric
        rates = np.diag(1 / self._times) - np.outer(root, root) / E0
        values, vectors = np.linalg.eigh(rates)
        start = vectors.T @ (np.sqrt(E / self._times) / E0)  # v = q / sqrt(E tau), q(0) = E / E0
        weights = vectors.T @ np.sqrt(E * self._times)
        return weights * start / self.equilibrium_pa, values

    def storage(self, angular_frequency: float) -> float:
        """E'(omega) [Pa] at an angular frequency [rad/s]."""
        x2 = np.square(_positive_frequency(angular_frequency) * self._times)
        return self.equilibrium_pa + float(np.sum(self._moduli * x2 / (1 + x2)))

    def loss(self, angular_frequency: float) -> float:
        """E''(omega) [Pa] at an angular frequency [rad/s]."""
        x = _positive_frequency(angular_frequency) * self._times
        return float(np.sum(self._moduli * x / (1 + x**2)))

    def loss_per_cycle(self, angular_frequency: float, strain_amplitude: float) -> float:
        """Energy pi E'' eps0^2 lost per cycle and volume [J/m^3]."""
        _not_negative("strain amplitude", strain_amplitude, "(a ratio)")
        return math.pi * self.loss(angular_frequency) * strain_amplitude**2

    def branches(self, time_s: History, signal: History) -> Branches:
        """P_i(t_n) [Pa times the signal] of a signal at rest before its first sample."""
        steps = _steps(time_s, signal)
        x = steps[:, None] / self._times
        fall = np.exp(-x)
        gain = self._moduli * -np.expm1(-x) / x * np.diff(signal)[:, None]
        stress = np.zeros((len(time_s), len(self.times_s)))
        for n in range(len(steps)):
            stress[n + 1] = fall[n] * stress[n] + gain[n]
        return stress

    def stress(self, time_s: History, strain: History) -> History:
        """Stress [Pa] under a history of strain that starts at 0."""
        if strain[0] != 0.0:
            raise RangeError(f"the first strain is {strain[0]:g}, not 0; start the history at rest")
        return np.asarray(self.equilibrium_pa * strain + self.branches(time_s, strain).sum(axis=1))

    @property
    def _moduli(self) -> Float[ndarray, " m"]:
        return np.array(self.moduli_pa, dtype=float)

    @property
    def _times(self) -> Float[ndarray, " m"]:
        return np.array(self.times_s, dtype=float)


def _steps(time_s: History, signal: History) -> Float[ndarray, " steps"]:
    if len(time_s) != len(signal) or len(time_s) < 2:
        raise RangeError(
            f"{len(time_s)} times and {len(signal)} values are no history; give at least 2, one time a value"
        )
    steps = np.diff(time_s)
    if not (np.isfinite(time_s).all() and np.isfinite(signal).all() and (steps > 0).all()):
        raise RangeError(
            "the history holds a time that does not increase, or a value that is not finite; a jump in no "
            "time is no history: give it a duration in s"
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


MIN_SUBSTEPS = 8  # minimum parts of each step
MAX_SHARE = 1e-3  # maximum part of the history's duration and depth
ELEMENTS = 400  # elements from the centre to the maximum contact radius
HALVINGS = 60  # bisections of t1

Times = Float[ndarray, " k"]


@dataclass(frozen=True, slots=True)
class Indentation:
    """Force and contact radius over a history of depth.

    Attributes:
        force_n: Never negative [N].
        radius_m: Contact radius, 0 without contact [m].
        loss_j: Net work of the probe, the area of a closed loop [J].
    """

    time_s: History
    depth_m: History
    force_n: History
    radius_m: History
    loss_j: float


def ting(
    time_s: History, depth_m: History, radius_m: float, skin: Prony, poisson_ratio: float
) -> Indentation:
    """Return force and contact radius for a depth that rises once, with or without holds, and then falls.

    Args:
        time_s: Increasing times [s].
        depth_m: Depth from 0, at most R/4 [m]; negative in the air.
        radius_m: Radius of the sphere [m].
        skin: Relaxation modulus.
        poisson_ratio: Constant, 0 to 0.5.

    Example:
        >>> t = np.linspace(0, 2, 101)
        >>> done = ting(t, 1e-3 * (1 - abs(1 - t)), 5e-3, Prony(0.2e6, (0.1e6,), (0.5,)), 0.49)
        >>> bool(done.loss_j > 0)
        True
    """
    _check(time_s, depth_m, radius_m)
    reduced_modulus(1.0, poisson_ratio)
    top = int(np.argmax(depth_m))
    if np.any(np.diff(depth_m[: top + 1]) < 0) or np.any(np.diff(depth_m[top:]) > 0):
        raise RangeError(
            "the depth does not rise once and then fall, as in Ting's law; use press for another history"
        )
    t, d, samples = _subdivide(time_s, depth_m)
    d, top = np.maximum(d, 0.0), int(samples[top])
    while top + 1 < len(d) and d[top + 1] == d[top]:
        top += 1  # a hold at the greatest depth is part of the rise
    t1, apart = _times_as_wide(_Remembered(skin, t, d), top)
    wide = np.sqrt(radius_m * np.maximum(np.interp(t1, t, d), 0.0))
    if np.any(np.diff(wide[top:]) > 1e-9 * wide[top]):
        raise RangeError(
            "the skin catches up with the sphere on its way back, and the contact would grow again, which "
            "Ting's law does not cover; use press"
        )
    pushed, memory = _Remembered(skin, t, d**1.5).left(t1, t)
    total = skin.equilibrium_pa * pushed + memory.sum(axis=1)
    total[apart] = 0.0
    K = 4.0 * math.sqrt(radius_m) / (3.0 * (1.0 - poisson_ratio**2))
    force = K * np.maximum(total, 0.0)
    return Indentation(time_s, depth_m, force[samples], wide[samples], float(np.trapezoid(force, d)))


class _Remembered:
    """A signal and its branches, at its samples and between them."""

    def __init__(self, skin: Prony, time_s: Times, signal: History) -> None:
        self.time_s, self.signal, self.branches = time_s, signal, skin.branches(time_s, signal)
        self._skin, self._taus = skin, np.array(skin.times_s)

    def left(self, t1: Times, later: Times) -> tuple[Times, Branches]:
        """The signal at t1, and P_i that its history up to t1 leaves at later times."""
        t, signal = self.time_s, self.signal
        j = np.minimum(np.searchsorted(t, t1, side="right") - 1, len(t) - 2)
        part = (t1 - t[j])[:, None] / self._taus
        slope = ((signal[j + 1] - signal[j]) / (t[j + 1] - t[j]))[:, None]
        gain = np.array(self._skin.moduli_pa) * self._taus * -np.expm1(-part) * slope
        fall = np.exp(-(later - t1)[:, None] / self._taus)
        return np.interp(t1, t, signal), fall * (np.exp(-part) * self.branches[j] + gain)

    def gained(self, t1: Times, first: int) -> Times:
        """Stress by the history since t1, at the samples from the first on; it falls with t1."""
        signal, memory = self.left(t1, self.time_s[first:])
        later = (self.branches[first:] - memory).sum(axis=1)
        return np.asarray(self._skin.equilibrium_pa * (self.signal[first:] - signal) + later)


def _times_as_wide(depth: _Remembered, top: int) -> tuple[Times, Bool[ndarray, " k"]]:
    """The earlier time t1 of equal contact radius for each sample, and where contact is lost."""
    t, back = depth.time_s, top + 1
    low, high = np.full(len(t) - back, t[0]), np.full(len(t) - back, t[top])
    apart = depth.gained(low, back) <= 0.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        wider = depth.gained(middle, back) > 0.0
        low, high = np.where(wider, middle, low), np.where(wider, high, middle)
    return np.append(t[:back], np.where(apart, t[0], low)), np.append(np.zeros(back, bool), apart)


def press(
    time_s: History, depth_m: History, radius_m: float, skin: Prony, poisson_ratio: float
) -> Indentation:
    """Return force (error about 1e-5) and contact radius (1/800) under any history of depth; arguments as for
    `ting`.
    """
    _check(time_s, depth_m, radius_m)
    reduced_modulus(1.0, poisson_ratio)
    t, d, samples = _subdivide(time_s, depth_m)
    widest = math.sqrt(radius_m * max(float(depth_m.max()), 0.0))
    dx = widest / ELEMENTS
    x = dx * (np.arange(ELEMENTS) + 0.5)
    height = x**2 / radius_m
    E, taus = np.array(skin.moduli_pa)[:, None], np.array(skin.times_s)[:, None]
    q, u = np.zeros((len(skin.times_s), ELEMENTS)), np.zeros(ELEMENTS)
    force, width = np.zeros(len(t)), np.zeros(len(t))
    for n, dt in enumerate(np.diff(t)):
        fall = np.exp(-dt / taus)
        gain = -E * taus / dt * np.expm1(-dt / taus)
        rigid = d[n + 1] - height
        faded, stiff = fall * q, gain.sum()
        rest = faded.sum(axis=0) - stiff * u
        free = -rest / (skin.equilibrium_pa + stiff)  # unloaded position
        touching = rigid > free
        after = np.where(touching, rigid, free)
        q, u = faded + gain * (after - u), after
        count = int(touching.sum())
        if count and not touching[:count].all():
            raise RangeError(
                f"at {t[n + 1]:g} s the sphere meets its own dent in a ring, which this law does not cover; "
                "wait longer between presses, or press as deep as before"
            )
        force[n + 1] = 2.0 * dx * float((skin.equilibrium_pa + stiff) * (rigid - free)[:count].sum())
        width[n + 1] = count * dx
    force /= 1.0 - poisson_ratio**2
    return Indentation(time_s, depth_m, force[samples], width[samples], float(np.trapezoid(force, d)))


def _check(time_s: History, depth_m: History, radius_m: float) -> None:
    _steps(time_s, depth_m)
    if depth_m[0] > 0.0:
        raise RangeError(f"the first depth is {depth_m[0]:g} m; start at first touch, 0 m, or above the skin")
    contact_radius(max(float(depth_m.max()), 0.0), radius_m)


def _subdivide(time_s: History, depth_m: History) -> tuple[Times, Times, Int[ndarray, " n"]]:
    """The history in short linear parts, and the indices of its samples."""
    before, after, steps = depth_m[:-1], depth_m[1:], np.diff(time_s)
    through = np.sign(before) * np.sign(after) < 0.0
    touches = (time_s[:-1] + steps * before / np.where(through, before - after, 1.0))[through]
    ends = np.union1d(time_s, touches)
    pushed = np.maximum(np.interp(ends, time_s, depth_m), 0.0)
    moved = np.abs(np.diff(pushed)) / (pushed.max() or 1.0)
    lasting = np.diff(ends) / (ends[-1] - ends[0])
    parts = np.maximum(MIN_SUBSTEPS, np.ceil(np.maximum(moved, lasting) / MAX_SHARE - 1e-9)).astype(int)
    at = np.append(0, np.cumsum(parts))
    fine = np.unique(np.interp(np.arange(at[-1] + 1), at, ends))
    return fine, np.interp(fine, time_s, depth_m), np.searchsorted(fine, time_s)
