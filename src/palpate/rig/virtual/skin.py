"""The force of a viscoelastic skin on a ball, sample after sample.

Elastic force from the finite-strain table; with every change dF of it a share g_i dF is added that fades with
time t_i (a Prony series: the table's modulus is the relaxed one). A ball is never pulled: below zero the
force is zero. That the contact of a skin that lags behind is smaller on the way back (Ting) is left out.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.signal import lfilter

from palpate.mechanics.press_table import PressTable
from palpate.sensors.palm import PalmSpec
from palpate.sensors.palm.field import table_of

Series = Float[ndarray, " n"]
KNOTS = 1201  # of depth, between which the table's force is read along straight lines


class Skin:
    """Remembers what the fading branches still hold."""

    def __init__(self, spec: PalmSpec, relaxation: tuple[tuple[float, float], ...]) -> None:
        table: PressTable = table_of(spec)
        R = spec.indenter_radius_m
        self.greatest_m = table.greatest_depth * R
        self._depth = np.linspace(0.0, self.greatest_m, KNOTS)
        unit = spec.youngs_modulus_pa * R**2
        self._force = table.force_at(self._depth / R) * unit
        self._branches = relaxation
        self._held = np.zeros(len(relaxation))
        self._last = 0.0

    def force(self, depth_m: Series, step_s: float) -> tuple[Series, Series]:
        """What the ball feels, and the elastic part of it, at samples `step_s` apart [N]."""
        elastic = np.interp(depth_m, self._depth, self._force, left=0.0)
        change = np.diff(elastic, prepend=self._last)
        total = elastic.copy()
        for i, (share, time_s) in enumerate(self._branches):
            fades = math.exp(-step_s / time_s)
            # A change is spread over its step, so that half of the step's fading has happened to it.
            gain = share * math.exp(-step_s / 2 / time_s)
            held, after = lfilter([gain], [1.0, -fades], change, zi=[fades * self._held[i]])
            self._held[i] = after[0] / fades
            total += held
        if len(elastic):
            self._last = float(elastic[-1])
        return np.maximum(total, 0.0), elastic
