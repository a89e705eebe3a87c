"""Presses of the virtual NUSense as cues with their true force: from true marks with noise, none rendered."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

import palpate
from palpate.calibration.shear.touch_cues import CueMeter, LabelledCues
from palpate.core import Pose, PressHistory
from palpate.estimators.lattice import ControlPoints

NOISE_PX = 0.05  # of a mark's place: the documented one
REST_PX = 0.02  # of the mean over reference frames
PLACES_M = (16e-3, 10.5e-3)  # half the sides of the box of places
LEVELS = 40
RATE_HZ, SPEED_M_S = 12.0, 0.5e-3


@dataclass(frozen=True)
class VirtualPad:
    """A virtual pad, its untouched marks, and cues against them."""

    copy: str = ""
    seed: int = 0

    @property
    def sensor(self):
        return palpate.sensor("nusense" + (f"-{self.copy}" if self.copy else ""))

    @property
    def reference(self) -> ControlPoints:
        rng = np.random.default_rng([self.seed, 7])
        return self.marks(self.contact("round", 0.0, 0.0, 0.0), rng, REST_PX)

    def contact(self, tip, x_m, y_m, depth_m, stiffening=1.0):
        sensor = self.sensor
        history = PressHistory(stiffening=stiffening)
        return sensor.press(sensor.probe(tip), Pose(float(x_m), float(y_m), float(depth_m)), history=history)

    def marks(self, contact, rng, noise_px=NOISE_PX) -> ControlPoints:
        truth = self.sensor.tile_corners(contact)
        places = truth.places_px + noise_px * rng.standard_normal(truth.places_px.shape)
        return ControlPoints(truth.cells, places, np.full(len(places), noise_px))

    def meter(self) -> CueMeter:
        spec = self.sensor.spec
        return CueMeter(self.reference, spec.lens, spec.camera_m)


@lru_cache
def levels(copy: str, tip: str, low_n: float, high_n: float, shift: float = 0.0, count: int = LEVELS):
    """Depths [m] at forces in even steps, and the forces [N]."""
    sensor = VirtualPad(copy).sensor
    probe = sensor.probe(tip)
    depth = np.linspace(0.02, 1.0, 16) * sensor.known_depth_m(probe)
    force = np.array([sensor.press(probe, Pose(0.0, 0.0, float(d))).force_n for d in depth])
    wanted = low_n + (high_n - low_n) * (np.arange(count) + shift) / (count - 1 + shift)
    return np.interp(wanted, force, depth)


def slow_presses(
    pad: VirtualPad, count, seed, tips=("round",), low_n=1.0, high_n=8.0, shift=0.0, of=LEVELS
) -> LabelledCues:
    """Presses of one frame each at random places and forces, so slow that the pad is relaxed."""
    rng, meter = np.random.default_rng([seed, 3]), pad.meter()
    cues, force = [], []
    which = [tips[i % len(tips)] for i in range(count)]
    for tip in which:
        x, y = rng.uniform(-1, 1, 2) * PLACES_M
        contact = pad.contact(tip, x, y, rng.choice(levels(pad.copy, tip, low_n, high_n, shift, of)))
        cues.append(meter.cues(pad.marks(contact, rng)))
        force.append(contact.force_n)
    names = np.array([f"press {i}" for i in range(count)])
    return LabelledCues(tuple(cues), np.array(force), np.zeros(count), names, np.array(which))


def cycles(pad: VirtualPad, count, seed, tip="round", high_n=8.0, speed_m_s=SPEED_M_S) -> LabelledCues:
    """Presses at a steady speed down to a random force and up again, with the pad's memory."""
    rng, meter = np.random.default_rng([seed, 5]), pad.meter()
    sensor = pad.sensor
    probe = sensor.probe(tip)
    grid = np.linspace(0.0, 1.0, 60) * sensor.known_depth_m(probe)
    force_of = np.array([0.0] + [sensor.press(probe, Pose(0.0, 0.0, float(d))).force_n for d in grid[1:]])
    cues, force, time, names = [], [], [], []
    for i in range(count):
        x, y = rng.uniform(-1, 1, 2) * PLACES_M
        top = np.interp(rng.uniform(0.4, 1.0) * high_n, force_of, grid)
        t = np.arange(-2 / RATE_HZ, 2 * top / speed_m_s + 2 / RATE_HZ, 1 / RATE_HZ) + rng.uniform(
            0, 1 / RATE_HZ
        )
        fine = np.arange(0.0, t[-1] + 1e-3, 1e-3)
        depth = np.clip(top - np.abs(speed_m_s * fine - top), 0.0, None)
        elastic = np.interp(depth, grid, force_of)
        total = elastic + sum(s * remembered(elastic, 1e-3, T) for s, T in sensor.spec.relaxation)
        for at in t:
            k = int(np.clip(round(at / 1e-3), 0, len(fine) - 1)) if at > 0 else 0
            d = grid[np.argmin(np.abs(grid - depth[k]))]  # so that contacts are kept
            share = d > 0 and total[k] > 0
            contact = pad.contact(tip, x, y, d if share else 0.0)
            stiff = total[k] / elastic[k] if share else 1.0
            cues.append(meter.cues(pad.marks(contact, rng)))
            force.append(contact.force_n * stiff)
            time.append(at + 100.0 * i)
            names.append(f"press {i}")
    n = len(cues)
    return LabelledCues(tuple(cues), np.array(force), np.array(time), np.array(names), np.full(n, tip))


def remembered(elastic, step_s, time_s):
    """Integral of exp(-(t - t')/T) dL(t')."""
    out, fades = np.zeros_like(elastic), np.exp(-step_s / time_s)
    for k in range(1, len(elastic)):
        out[k] = out[k - 1] * fades + (elastic[k] - elastic[k - 1]) * np.sqrt(fades)
    return out
