"""Errors of flow against the true motion, and of the contact models: linearity and friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from palpate.estimators.compliance.spread_rate import summed_slopes
from palpate.estimators.pins import find_pins, follow
from palpate.sensors.tactip import TacTipSpec, pictured
from palpate.sensors.tactip.inclined_press import inclined, linear_inclined
from palpate.sensors.tactip.tactip_press import modulus_pa
from palpate.workflows.tactip_trials import VirtualPress
from palpate_reproductions.tactip.tactip_conditions import (
    ASSUMED,
    FINE_STEPS,
    FROM_N,
    HIGH_N,
    KAPPA_N_M,
    LOW_N,
    NEAR,
    POLAR,
    TO_N,
    DivergenceSeries,
    Row,
    Steps,
    circles_px,
    flow_divergence,
    head_on,
    marker_radii_px,
    middle_px,
    recorded,
    row_of,
    true_divergence,
)

METHODS = ("horn-schunck", "dis", "tracked")


@dataclass(frozen=True)
class DivergenceShare:
    """Accumulated divergence by a method over that of the true markers."""

    pins: int
    kappa_n_m: float
    method: str
    region: str
    mean: float
    spread: float


def divergence_shares(
    spec: TacTipSpec, kappa_n_m: float, seeds: Sequence[int] = range(3), methods: Sequence[str] = METHODS
) -> tuple[DivergenceShare, ...]:
    """Shares by every method over disc and contact, from 0.5 to 5 N."""
    results: dict[tuple[str, str], list[float]] = {}
    for seed in seeds:
        trial, _ = recorded(spec, kappa_n_m, seed)
        press, force = head_on(spec, kappa_n_m).press, trial.true_force_n[trial.frame_sample]
        circles = {name: circles_px(spec, press, force)[name] for name in ("disc", "contact")}
        true = true_divergence(spec, press, force)
        for method in methods:
            tracked = method == "tracked"
            series = (
                tracked_divergence(trial, circles) if tracked else flow_divergence(trial, circles, method)
            )
            for region, D in series.items():
                results.setdefault((method, region), []).append(float(D.sum() / true[region].sum()))
    return tuple(
        DivergenceShare(
            spec.pins.count, kappa_n_m, *key, float(np.mean(v)), float(np.std(v, ddof=len(v) > 1))
        )
        for key, v in results.items()
    )


@dataclass(frozen=True)
class PressTruth:
    """One specimen at forces, by finite strain; SI.

    Attributes:
        divergence: of the true markers over the region, accumulated from 0.5 N to each force.
    """

    kappa_n_m: float
    force_n: Steps
    area_m2: Steps
    casr_m2_n: Steps
    flattening_m: Steps
    approach_m: Steps
    divergence: dict[str, Steps]


def press_truth(
    spec: TacTipSpec, kappa_n_m: float, force_n: Sequence[float] = (1.0, 2.0, 3.0, 4.0, 5.0)
) -> PressTruth:
    """True values of a press, and of its pins."""
    press, at = head_on(spec, kappa_n_m).press, np.array(force_n)
    fine = np.linspace(LOW_N, HIGH_N, FINE_STEPS)
    area, above, below = (press.at("area_m2", at + step) for step in (0.0, 0.05, -0.05))
    so_far = {
        name: np.interp(at, fine[1:], np.cumsum(D)) for name, D in true_divergence(spec, press, fine).items()
    }
    flattening, approach = press.at("flattening_m", at), press.at("approach_m", at)
    return PressTruth(kappa_n_m, at, area, (above - below) / 0.1, flattening, approach, so_far)


@dataclass(frozen=True)
class LinearModelError:
    """The linear model head-on without friction, over finite strain, less 1.

    Attributes:
        motion: of the markers: the difference's root mean square over the true motion's.
    """

    tip: str
    kappa_n_m: float
    force_n: Steps
    approach: Steps
    area: Steps
    motion: Steps


def linear_error(
    tip: str,
    kappa_n_m: float,
    force_n: Sequence[float] = (1.0, 2.0, 3.0, 4.0, 5.0),
    base: TacTipSpec = ASSUMED,
) -> LinearModelError:
    """Error of the linear model at forces; half a minute for a new tip."""
    spec, at = replace(base, tip=tip, friction=0.0), np.array(force_n)
    true = head_on(spec, kappa_n_m)
    linear = linear_inclined(spec, modulus_pa(spec.table, kappa_n_m), 0.0)
    deep = np.linspace(0.0, linear.deepest_m, 2000)
    approach = np.interp(at, linear.force_n(deep), deep)
    true_approach = true.press.at("approach_m", at)
    rest = pictured(spec, true.skin(0.0, (0.0, 0.0)))[0]
    motion = []
    for theirs, ours in zip(approach, true_approach, strict=True):
        a, b = (
            pictured(spec, s.skin(float(d), (0.0, 0.0)))[0] - rest
            for s, d in ((linear, theirs), (true, ours))
        )
        motion.append(float(np.sqrt(((a - b) ** 2).sum() / (b**2).sum())))
    return LinearModelError(
        tip, kappa_n_m, at, approach / true_approach - 1,
        linear.area_m2(at) / true.press.at("area_m2", at) - 1, np.array(motion),
    )  # fmt: skip


def inclined_error(
    kappa_n_m: float, tilt_rad: float, force_n: Sequence[float] = (1.0, 3.0, 5.0)
) -> LinearModelError:
    """The same on an inclined top, of the tip "base", against its table."""
    spec, at = TacTipSpec(friction=0.0), np.array(force_n)
    pa = modulus_pa(spec.table, kappa_n_m)
    true, linear = inclined(spec, pa, tilt_rad), linear_inclined(spec, pa, tilt_rad)
    approaches = []
    for press in (linear, true):
        deep = np.linspace(0.0, press.deepest_m, 2000)
        approaches.append(np.interp(at, press.force_n(deep), deep))
    rest = pictured(spec, true.skin(0.0, (0.0, 0.0)))[0]
    motion = []
    for theirs, ours in zip(*approaches, strict=True):
        a, b = (
            pictured(spec, press.skin(float(deep), (0.0, 0.0)))[0] - rest
            for press, deep in ((linear, theirs), (true, ours))
        )
        motion.append(float(np.sqrt(((a - b) ** 2).sum() / (b**2).sum())))
    return LinearModelError(
        spec.tip, kappa_n_m, at, approaches[0] / approaches[1] - 1,
        linear.area_m2(at) / true.area_m2(at) - 1, np.array(motion),
    )  # fmt: skip


def areas_by_friction(
    tilt_rad: float, frictions: Sequence[float] = (0.0, 0.5, 1.0), force_n: float = HIGH_N
) -> dict[float, tuple[float, ...]]:
    """Contact area on every specimen, stiffest first, by Coulomb's coefficient [m^2]; ten seconds a press."""
    results = {}
    for friction in frictions:
        spec = replace(TacTipSpec(), friction=friction)
        specimens = (linear_inclined(spec, modulus_pa(spec.table, k), tilt_rad) for k in KAPPA_N_M.values())
        results[friction] = tuple(float(s.area_m2(np.array([force_n]))[0]) for s in specimens)
    return results


def tracked_divergence(trial: VirtualPress, circles: DivergenceSeries) -> DivergenceSeries:
    """The same from pins that are followed: a line through the outward motion of those near the circle."""
    frames = trial.frames()
    first = find_pins(next(frames))
    near = NEAR * trial.sensor.spec.camera.disc_px / trial.sensor.spec.pins.rings
    places = [first.xy_px, *(pins.xy_px for pins in follow(frames, first))]
    results: dict[str, list[float]] = {name: [] for name in circles if name != "whole"}
    for j, (now, later) in enumerate(pairwise(places)):
        off = now - middle_px(trial)
        r = np.hypot(*off.T)
        away = ((later - now) * off).sum(axis=1) / np.maximum(r, 1.0)
        for name in results:
            c = circles[name][j]
            here = (np.abs(r - c) < near) & np.isfinite(away)
            results[name].append(float(2 * np.polyfit(r[here] - c, away[here], 1)[1] / c))
    return {name: np.array(values) for name, values in results.items()}


@dataclass(frozen=True)
class PeakMotion:
    """Where markers have moved outwards most in the image, on one specimen at forces.

    Attributes:
        peak_rad: polar angle on the skin's inside of the pin that has, among those within the field; NaN
            where it is the outermost, so that there is no ring [rad].
        moved_px: how far that pin has moved outwards; the farthest of all where there is no ring [px].
    """

    kappa_n_m: float
    force_n: Steps
    peak_rad: Steps
    edge_rad: Steps
    moved_px: Steps


def peak_motion(
    spec: TacTipSpec, kappa_n_m: float, force_n: Sequence[float] = (1.0, 2.0, 3.0, 4.0, 5.0)
) -> PeakMotion:
    """The ring of greatest outward motion, from the true motion of imagined pins at every polar angle."""
    press, at = head_on(spec, kappa_n_m).press, np.array(force_n)
    away = marker_radii_px(spec, press, at) - marker_radii_px(spec, press, np.zeros(1))
    outermost = np.arcsin(spec.pins.rings * spec.pins.pitch_m / spec.inner_radius_m)
    inside = outermost >= POLAR
    best = np.argmax(away[:, inside], axis=1)
    peak = np.where(best < inside.sum() - 1, POLAR[best], np.nan)
    return PeakMotion(kappa_n_m, at, peak, press.at("angle_rad", at), away[:, inside].max(axis=1))


def sensitivity(base: TacTipSpec = ASSUMED, lengths_mm: Sequence[float] = (0.0, 1.0, 2.5)) -> tuple[Row, ...]:
    """True markers' divergence from 1 to 4 N: four tips, lengths of pins, refraction or none."""
    force = np.linspace(FROM_N, TO_N, FINE_STEPS)
    rows = []
    for tip, mm, index in product(("base", "soft-skin", "stiff-skin", "even"), lengths_mm, (1.0, 1.41)):
        pins, camera = replace(base.pins, length_m=1e-3 * mm), replace(base.camera, gel_index=index)
        spec = replace(base, tip=tip, pins=pins, camera=camera)
        results = [true_divergence(spec, head_on(spec, k).press, force) for k in KAPPA_N_M.values()]
        for region in results[0]:
            names = (f"{tip}, pins of {mm:g} mm, index {index:g}", "true", region, "divergence")
            rows.append(row_of(names, [D[region].sum(keepdims=True) for D in results]))
    return tuple(rows)


def equation_12(kappa_n_m: float, slope: float = 10.0, stride_m: float = 0.25e-3) -> float:
    """Equation (12) where the area is the same function of force on every specimen, a straight line.

    A rigid plate presses at 5 mm/s before 20 frames a second, up to 5 N; what comes out is the slope times
    the number of steps.
    """
    force = np.arange(0.0, HIGH_N, kappa_n_m * stride_m)
    return summed_slopes(force, 100.0 + slope * force)
