"""The force of a viscoelastic skin on a probe, sample after sample.

Elastic force from the sensor's own law, as far as it holds; with every change dF of it a share g_i dF is
added that fades with time t_i (a Prony series: the modulus is the relaxed one). A probe is never pulled:
below zero the force is zero. That the contact of a skin that lags behind is smaller on the way back (Ting) is
left out.

When the probe has left, what is left is a dent: each branch has come to some depth, of which its share
remains and fades with its own time. The next touch is of the dented skin, and begins without memory.
"""

from __future__ import annotations

import math

import numpy as np
from numpy import ndarray
from scipy.signal import lfilter

from palpate.core.sensor import ForceLaw
from palpate.core.shapes import Float

Series = Float[ndarray, " n"]


class Skin:
    """Remembers what the fading branches still hold."""

    def __init__(self, law: ForceLaw, relaxation: tuple[tuple[float, float], ...]) -> None:
        self.law = law
        self._branches = relaxation
        self._held = np.zeros(len(relaxation))
        self._reached_m = np.zeros(len(relaxation))
        self._last = 0.0

    def force(self, depth_m: Series, step_s: float) -> tuple[Series, Series]:
        """What the probe feels, and the elastic part of it, at samples `step_s` apart [N]."""
        elastic = np.interp(depth_m, self.law.depth_m, self.law.force_n, left=0.0)
        change = np.diff(elastic, prepend=self._last)
        total = elastic.copy()
        for i, (share, time_s) in enumerate(self._branches):
            fades = math.exp(-step_s / time_s)
            # A change is spread over its step, so that half of the step's fading has happened to it.
            gain = share * math.exp(-step_s / 2 / time_s)
            held, after = lfilter([gain], [1.0, -fades], change, zi=[fades * self._held[i]])
            self._held[i] = after[0] / fades
            total += held
            pressed = np.maximum(depth_m, 0.0)
            reached, _ = lfilter([1.0 - fades], [1.0, -fades], pressed, zi=[fades * self._reached_m[i]])
            self._reached_m[i] = reached[-1] if len(reached) else self._reached_m[i]
        if len(elastic):
            self._last = float(elastic[-1])
        return np.maximum(total, 0.0), elastic

    def leave(self) -> tuple[float, ...]:
        """The probe has left: the dent that each branch holds [m]; memory begins anew."""
        whole = 1.0 + sum(share for share, _ in self._branches)
        dents = zip(self._branches, self._reached_m, strict=True)
        left = tuple(float(share / whole * reached) for (share, _), reached in dents)
        self._held[:], self._reached_m[:], self._last = 0.0, 0.0, 0.0
        return left

    def radius_at(self, depth_m: float) -> float:
        """Of the contact [m]."""
        return float(np.interp(depth_m, self.law.depth_m, self.law.radius_m, left=0.0))

    def lateral_at(self, depth_m: float) -> float:
        """Force for a small shift along the skin [N/m]."""
        return float(np.interp(depth_m, self.law.depth_m, self.law.lateral_n_m, left=0.0))
