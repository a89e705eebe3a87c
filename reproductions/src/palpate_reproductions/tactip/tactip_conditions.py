"""Controls on the virtual TacTip: does the divergence of its pin image tell softness, or the frames' count?

The mean divergence of every step of a press is taken over regions of the image: true, by flow, by tracked
pins. Regions are discs around the tip's axis: the `whole` image, the `disc` that untouched pins fill, the
true `contact` as the camera would see pins at its edge, and the `middle`, inside the pins 6 mm from the axis.

The report's four specimens are pressed head-on from 0.5 to 5 N. Every step from frame to frame has a mean
divergence over a region of the image (`courses`), from flow of rendered frames or from the markers' true
motion; of these come the report's equation (12), the secant, and the regression. What a region says is set
beside specimens' known order. All is of one model: verified, not validated.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from palpate.core import Float, ndarray
from palpate.estimators.compliance.pin_press import at_forces
from palpate.estimators.compliance.spread_rate import area_m2, paper_spread, spread
from palpate.estimators.compliance.stiffness_curve import loading, moving_average, within
from palpate.estimators.flow.horn_schunck import course, divergence
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress
from palpate.rig.virtual.linear_rig import LINEAR_RIG, LinearRig
from palpate.sensors.tactip import PINS_331, HeadOn, TacTipSpec
from palpate.sensors.tactip.tactip_camera import projected
from palpate.sensors.tactip.tactip_press import HeadOnSkin, modulus_pa, pixels_per_tangent
from palpate.workflows.tactip_trials import VirtualPress, record_press

LOW_N, HIGH_N = 0.5, 5.0
MIDDLE_M = 6e-3
POLAR = np.linspace(1e-3, np.deg2rad(70.0), 141)  # of imagined pins, all along a meridian
NEAR = 0.8  # of the pins' pitch: those by which a circle's motion is told

Region = Literal["whole", "disc", "contact", "middle"]
REGIONS: tuple[Region, ...] = ("whole", "disc", "contact", "middle")
Steps = Float[ndarray, " _"]  # one a step, a frame or a force
DivergenceSeries = dict[str, Steps]  # of every step, by region


def head_on(spec: TacTipSpec, kappa_n_m: float) -> HeadOn:
    """The tip on a specimen by finite strain."""
    return HeadOn(spec.table.press(modulus_pa(spec.table, kappa_n_m)), spec.table.radius_m)


def marker_radii_px(
    spec: TacTipSpec, press: HeadOnPress, force_n: Float[ndarray, " f"]
) -> Float[ndarray, "f n"]:
    """Distance from the axis in the image of the markers of pins at `POLAR`, at every force [px]."""
    scale, base = pixels_per_tangent(spec), spec.table.radius_m
    rows = []
    for inside in press.at("inside_m", force_n):
        places, normals = HeadOnSkin(press.polar_rad, inside).at(POLAR, np.zeros_like(POLAR))
        tangent, _ = projected(places + spec.pins.length_m * normals, spec.camera, base)
        rows.append(scale * tangent[:, 0])
    return np.stack(rows)


def circles_px(spec: TacTipSpec, press: HeadOnPress, force_n: Float[ndarray, " f"]) -> DivergenceSeries:
    """Radius of every region's circle halfway through every step from one force to the next [px].

    Halfway, since the contact grows during a step: a circle from its beginning would make divergence depend
    on how long steps are.
    """
    inner, even = spec.table.radius_m - spec.table.skin_m, np.ones(len(force_n) - 1)
    seen, edge = marker_radii_px(spec, press, force_n), press.at("angle_rad", force_n)
    untouched = marker_radii_px(spec, press, np.zeros(1))[0]
    contact = np.array([np.interp(a, POLAR, r) for a, r in zip(edge, seen, strict=True)])
    return {
        "whole": np.inf * even,
        "disc": spec.camera.disc_px * even,
        "contact": (contact[1:] + contact[:-1]) / 2,
        "middle": np.interp(np.arcsin(MIDDLE_M / inner), POLAR, untouched) * even,
    }


def true_divergence(spec: TacTipSpec, press: HeadOnPress, force_n: Float[ndarray, " f"]) -> DivergenceSeries:
    """Mean divergence of the markers' true motion: 2 u_r(r) / r on a circle of radius r, for every step.

    Of the whole image there is none: beyond the pins nothing moves that could be true.
    """
    seen, circles = marker_radii_px(spec, press, force_n), circles_px(spec, press, force_n)

    def of(circle: Steps) -> Steps:
        pairs = zip(circle, pairwise(seen), strict=True)
        return np.array([2 * np.interp(c, (now + later) / 2, later - now) / c for c, (now, later) in pairs])

    return {name: of(circle) for name, circle in circles.items() if name != "whole"}


def recorded(
    spec: TacTipSpec, kappa_n_m: float, seed: int, steps: int | None = None, rig: LinearRig | None = None
) -> tuple[VirtualPress, Steps]:
    """A trial with only its frames from 0.5 to 5 N, and their smoothed forces [N].

    Args:
        steps: None for the frames that there are; else that many even steps of time for any specimen, which
            are even steps of approach on an ideal rig.
        rig: that drives the tip; None for an ideal one.
    """
    trial = record_press(spec, f"specimen={1e-3 * kappa_n_m:.15g}", seed, rig)
    force = moving_average(trial.raw_n)
    samples = within(force, loading(force, LOW_N), LOW_N, HIGH_N)
    if steps is None:
        at = trial.frame_sample[np.isin(trial.frame_sample, samples)]
    else:
        at = np.rint(np.linspace(samples[0], samples[-1], steps + 1)).astype(np.int64)
    return replace(trial, frame_sample=at), force[at]


def flow_divergence(
    trial: VirtualPress, circles: DivergenceSeries, method: str = "horn-schunck"
) -> DivergenceSeries:
    """Mean divergence by a method of `horn_schunck.course`, for every step and region."""
    far = _from_axis(trial)
    results: dict[str, list[float]] = {name: [] for name in circles}
    for j, step in enumerate(course(trial.frames(), method)):
        spreading = divergence(step.field)
        for name, circle in circles.items():
            results[name].append(float(spreading[far < circle[j]].mean(dtype=np.float64)))
    return {name: np.array(values) for name, values in results.items()}


def middle_px(trial: VirtualPress) -> Float[ndarray, 2]:
    """The tip's axis in the image of a trial [px]."""
    return (trial.sensor.spec.camera.size_px - 1) / 2 + np.array(trial.seating.shift_px)


def _from_axis(trial: VirtualPress) -> Float[ndarray, "h w"]:
    y, x = np.mgrid[: trial.sensor.spec.camera.size_px, : trial.sensor.spec.camera.size_px]
    at = middle_px(trial)
    return np.hypot(x - at[0], y - at[1])


KAPPA_N_M = {"S1": 7600.0, "Snew": 5300.0, "S2": 3100.0, "S3": 1100.0}
"""The report's specimens, stiffest first."""

FROM_N, TO_N = 1.0, 4.0  # between these divergence is read: frames seldom fall on the ends of a press
FINE_STEPS = 200  # of the markers' true motion where no frames are equation_12
WAYS = ("divergence", "paper", "secant", "regression")


@dataclass(frozen=True)
class FlowCues:
    """One trial.

    Attributes:
        steps: from frame to frame.
        values: by source ("flow", "true"), region, and way of `WAYS`; the first is accumulated from 1 to 4 N,
            the others are in m^2/N, of all steps, with the report's first area, that of all pins.
        casr_m2_n: secant of the true contact area.
    """

    kappa_n_m: float
    steps: int
    values: dict[tuple[str, str, str], float]
    casr_m2_n: float


def cues(
    spec: TacTipSpec, kappa_n_m: float, seed: int, steps: int | None = None, rig: LinearRig | None = None
) -> FlowCues:
    """Cues of one press by Horn and Schunck's flow, and by the true markers; see `recorded`."""
    trial, force = recorded(spec, kappa_n_m, seed, steps, rig)
    press, true_n = head_on(spec, kappa_n_m).press, trial.true_force_n[trial.frame_sample]
    circles = circles_px(spec, press, true_n)
    values = {
        (source, region, way): value
        for source, courses in (
            ("flow", flow_divergence(trial, circles)),
            ("true", true_divergence(spec, press, true_n)),
        )
        for region, D in courses.items()
        for way, value in zip(WAYS, _ways(spec, force, D), strict=True)
    }
    area = trial.true_area_m2[trial.frame_sample]
    return FlowCues(kappa_n_m, len(force) - 1, values, spread(force, area, "secant").rate_m2_n)


def _ways(spec: TacTipSpec, force_n: Steps, D: Steps) -> tuple[float, float, float, float]:
    first = float(np.pi * (spec.pins.rings * spec.pins.pitch_m) ** 2)
    from_to = at_forces(force_n, np.concatenate([[0.0], np.cumsum(D)]), np.array([FROM_N, TO_N]))
    area = np.concatenate([[first], area_m2(first, D)])
    rates = [spread(force_n, area, way).rate_m2_n for way in ("secant", "regression")]
    paper = paper_spread(force_n[1:], D, first).rate_m2_n
    return float(np.diff(from_to)[0]), paper, rates[0], rates[1]


@dataclass(frozen=True)
class Row:
    """One cue on all specimens, stiffest first.

    Attributes:
        condition, source, region, way: which; see `FlowCues`.
        concordance: over pairs of trials on two specimens, the share in which the softer has the greater
            value less the share in which it has the smaller: 1 is right always, -1 reversed always.
    """

    condition: str
    source: str
    region: str
    way: str
    mean: tuple[float, ...]
    spread: tuple[float, ...]
    concordance: float

    @property
    def order(self) -> str:
        return order(self.mean)


def order(values: Sequence[float]) -> str:
    """Order of the values of ever softer specimens: "right" where they grow, "reversed", or "mixed"."""
    steps = np.diff(values)
    return "right" if (steps > 0).all() else "reversed" if (steps < 0).all() else "mixed"


def concordance(by_specimen: Sequence[Float[ndarray, " t"]]) -> float:
    """See `Row`."""
    signs = [
        np.sign(softer[:, None] - stiffer).ravel()
        for i, stiffer in enumerate(by_specimen)
        for softer in by_specimen[i + 1 :]
    ]
    return float(np.concatenate(signs).mean())


@dataclass(frozen=True)
class TacTipCondition:
    """The sensor, and the steps of a press: equal for all specimens, or None for the camera's frames.

    Attributes:
        rig: that drives the tip; None for an ideal one.
    """

    spec: TacTipSpec
    steps: int | None = None
    rig: LinearRig | None = None


ASSUMED = TacTipSpec()
AS_IS = "as assumed"  # nothing changed


def conditions_of(base: TacTipSpec) -> dict[str, TacTipCondition]:
    """A sensor as it is, and with one thing changed at a time, by name."""

    def seen_by(**camera: Any) -> TacTipSpec:
        return replace(base, camera=replace(base.camera, **camera))

    def pins_of(length_m: float) -> TacTipSpec:
        return replace(base, pins=replace(base.pins, length_m=length_m))

    return {
        AS_IS: TacTipCondition(base),
        "half the speed": TacTipCondition(replace(base, speed_m_s=2.5e-3)),
        "twice the speed": TacTipCondition(replace(base, speed_m_s=10e-3)),
        "20 frames each": TacTipCondition(base, 20),
        "wider pins": TacTipCondition(seen_by(disc_px=130.0)),
        "tight crop": TacTipCondition(seen_by(disc_px=165.0)),
        "tight crop, 20 frames each": TacTipCondition(seen_by(disc_px=165.0), 20),
        "no pin length": TacTipCondition(pins_of(0.0)),
        "pins of 1 mm": TacTipCondition(pins_of(1e-3)),
        "331 pins": TacTipCondition(replace(base, pins=PINS_331)),
        "no refraction": TacTipCondition(seen_by(gel_index=1.0)),
        "soft-skin tip": TacTipCondition(replace(base, tip="soft-skin")),
        "stiff-skin tip": TacTipCondition(replace(base, tip="stiff-skin")),
        "even tip": TacTipCondition(replace(base, tip="even")),
        "linear rig": TacTipCondition(base, rig=LINEAR_RIG),
    }


CONDITIONS = conditions_of(ASSUMED)


def compared(
    names: Sequence[str] = tuple(CONDITIONS), seeds: Sequence[int] = range(5), base: TacTipSpec = ASSUMED
) -> tuple[Row, ...]:
    """Every cue of a sensor under every condition; about a second a trial."""
    conditions = conditions_of(base)
    return tuple(row for name in names for row in _rows(name, conditions[name], seeds))


def _rows(name: str, condition: TacTipCondition, seeds: Sequence[int]) -> Iterator[Row]:
    trials = [
        [cues(condition.spec, kappa, seed, condition.steps, condition.rig) for seed in seeds]
        for kappa in KAPPA_N_M.values()
    ]
    for key in trials[0][0].values:
        yield row_of((name, *key), [np.array([t.values[key] for t in some]) for some in trials])
    yield row_of((name, "camera", "", "steps"), [np.array([float(t.steps) for t in some]) for some in trials])
    yield row_of(
        (name, "truth", "contact", "secant"), [np.array([t.casr_m2_n for t in some]) for some in trials]
    )


def row_of(names: tuple[str, str, str, str], values: Sequence[Float[ndarray, " t"]]) -> Row:
    """Mean, spread and concordance of a cue over trials; its names are condition, source, region and way."""
    several = len(values[0]) > 1
    sd = tuple(float(v.std(ddof=1)) if several else float("nan") for v in values)
    return Row(*names, tuple(float(v.mean()) for v in values), sd, concordance(values))
