"""The force of a viscoelastic skin on a probe, sample after sample.

Elastic force from the finite-strain table under the palm's own ball, and from linear layers under any other
probe, as far as they hold; with every change dF of it a share g_i dF is added that fades with time t_i (a
Prony series: the modulus is the relaxed one). A probe is never pulled: below zero the force is zero. That the
contact of a skin that lags behind is smaller on the way back (Ting) is left out.

When the probe has left, what is left is a dent: each branch has come to some depth, of which its share
remains and fades with its own time. The next touch is of the dented skin, and begins without memory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy import ndarray
from scipy.interpolate import PchipInterpolator
from scipy.signal import lfilter

from palpate.core.contact import Pose, Probe
from palpate.core.shapes import Float
from palpate.mechanics.press_table import PressTable
from palpate.sensors import palm
from palpate.sensors.palm import PalmSpec
from palpate.sensors.palm.field import table_of
from palpate.sensors.palm.press import LINEAR_DEPTH_M

Series = Float[ndarray, " n"]
Knots = Float[ndarray, " k"]
KNOTS = 1201  # of depth, between which force is read along straight lines
PRESSES = 13  # of linear layers, between which a curve is laid


@dataclass(frozen=True, slots=True, eq=False)
class Law:
    """What a probe feels of the relaxed skin, over depth.

    Attributes:
        depth_m: ascending from 0, to the deepest that is known.
        force_n: at each.
        radius_m: of the contact, or of a circle as large.
    """

    depth_m: Knots
    force_n: Knots
    radius_m: Knots

    @property
    def greatest_m(self) -> float:
        """The deepest that is known."""
        return float(self.depth_m[-1])


def own_ball(spec: PalmSpec) -> Probe:
    """The probe of the palm's own protocol."""
    return Probe("sphere", spec.indenter_radius_m)


@lru_cache(maxsize=16)
def law_of(spec: PalmSpec, probe: Probe) -> Law:
    """The law of a skin under a probe."""
    return _of_table(spec) if probe == own_ball(spec) else _of_layers(spec, probe)


def _of_table(spec: PalmSpec) -> Law:
    table: PressTable = table_of(spec)
    R = spec.indenter_radius_m
    depth = np.linspace(0.0, table.greatest_depth * R, KNOTS)
    force = table.force_at(depth / R) * spec.youngs_modulus_pa * R**2
    return Law(depth, force, np.interp(depth, table.depth * R, table.contact_radius * R))


def _of_layers(spec: PalmSpec, probe: Probe) -> Law:
    pressed = np.linspace(0.0, LINEAR_DEPTH_M, PRESSES)
    contacts = [palm.press(spec, Pose(0.0, 0.0, float(d)), probe) for d in pressed]
    area = [c.touching.sum() * (c.x_m[1] - c.x_m[0]) * (c.y_m[1] - c.y_m[0]) for c in contacts]
    depth = np.linspace(0.0, LINEAR_DEPTH_M, KNOTS)
    force = PchipInterpolator(pressed, [c.force_n for c in contacts])(depth)
    radius = PchipInterpolator(pressed, np.sqrt(np.array(area) / math.pi))(depth)
    return Law(depth, np.asarray(force), np.asarray(radius))


class Skin:
    """Remembers what the fading branches still hold."""

    def __init__(self, law: Law, relaxation: tuple[tuple[float, float], ...]) -> None:
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
