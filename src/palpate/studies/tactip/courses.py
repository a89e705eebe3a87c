"""The mean divergence of every step of a press over regions of the image: true, by flow, by tracked pins.

Regions are discs around the tip's axis: the `whole` image, the `disc` that untouched pins fill, the true
`contact` as the camera would see pins at its edge, and the `middle`, inside the pins 6 mm from the axis.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy import ndarray

from palpate.core.shapes import Float
from palpate.estimators.compliance import loading, moving_average, within
from palpate.estimators.flow import divergence
from palpate.estimators.flow.flow_sequence import course
from palpate.estimators.pins import find_pins, follow
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress
from palpate.sensors.tactip import HeadOn, TacTipSpec, Trial, trial
from palpate.sensors.tactip.camera import projected
from palpate.sensors.tactip.pins import HeadOnSkin
from palpate.sensors.tactip.press import modulus_pa, pixels_per_tangent

LOW_N, HIGH_N = 0.5, 5.0
MIDDLE_M = 6e-3
POLAR = np.linspace(1e-3, np.deg2rad(70.0), 141)  # of imagined pins, all along a meridian
NEAR = 0.8  # of the pins' pitch: those by which a circle's motion is told

Region = Literal["whole", "disc", "contact", "middle"]
REGIONS: tuple[Region, ...] = ("whole", "disc", "contact", "middle")
Steps = Float[ndarray, " _"]  # one a step, a frame or a force
Courses = dict[str, Steps]  # of every step, by region


def head_on(spec: TacTipSpec, kappa_n_m: float) -> HeadOn:
    """The tip on a specimen by finite strain."""
    return HeadOn(spec.table.press(modulus_pa(spec.table, kappa_n_m)), spec.table.radius_m)


def seen_px(spec: TacTipSpec, press: HeadOnPress, force_n: Float[ndarray, " f"]) -> Float[ndarray, "f n"]:
    """Distance from the axis in the image of the markers of pins at `POLAR`, at every force [px]."""
    scale, base = pixels_per_tangent(spec), spec.table.radius_m
    rows = []
    for inside in press.at("inside_m", force_n):
        places, normals = HeadOnSkin(press.polar_rad, inside).at(POLAR, np.zeros_like(POLAR))
        tangent, _ = projected(places + spec.pins.length_m * normals, spec.camera, base)
        rows.append(scale * tangent[:, 0])
    return np.stack(rows)


def circles_px(spec: TacTipSpec, press: HeadOnPress, force_n: Float[ndarray, " f"]) -> Courses:
    """Radius of every region's circle halfway through every step from one force to the next [px].

    Halfway, since the contact grows during a step: a circle from its beginning would make divergence depend
    on how long steps are.
    """
    inner, even = spec.table.radius_m - spec.table.skin_m, np.ones(len(force_n) - 1)
    seen, edge = seen_px(spec, press, force_n), press.at("angle_rad", force_n)
    untouched = seen_px(spec, press, np.zeros(1))[0]
    contact = np.array([np.interp(a, POLAR, r) for a, r in zip(edge, seen, strict=True)])
    return {
        "whole": np.inf * even,
        "disc": spec.camera.disc_px * even,
        "contact": (contact[1:] + contact[:-1]) / 2,
        "middle": np.interp(np.arcsin(MIDDLE_M / inner), POLAR, untouched) * even,
    }


def true_course(spec: TacTipSpec, press: HeadOnPress, force_n: Float[ndarray, " f"]) -> Courses:
    """Mean divergence of the markers' true motion: 2 u_r(r) / r on a circle of radius r, for every step.

    Of the whole image there is none: beyond the pins nothing moves that could be true.
    """
    seen, circles = seen_px(spec, press, force_n), circles_px(spec, press, force_n)

    def of(circle: Steps) -> Steps:
        pairs = zip(circle, pairwise(seen), strict=True)
        return np.array([2 * np.interp(c, (now + later) / 2, later - now) / c for c, (now, later) in pairs])

    return {name: of(circle) for name, circle in circles.items() if name != "whole"}


def recorded(spec: TacTipSpec, kappa_n_m: float, seed: int, steps: int | None = None) -> tuple[Trial, Steps]:
    """A trial with only its frames from 0.5 to 5 N, and their smoothed forces [N].

    Args:
        spec: the sensor; its speed counts.
        kappa_n_m: of the specimen [N/m].
        seed: of seating and noise.
        steps: None for the frames that there are; else that many even steps of approach for any specimen.
    """
    made = trial(spec, head_on(spec, kappa_n_m), seed)
    force = moving_average(made.raw_n)
    samples = within(force, loading(force, LOW_N), LOW_N, HIGH_N)
    if steps is None:
        at = made.frame_sample[np.isin(made.frame_sample, samples)]
    else:
        at = np.rint(np.linspace(samples[0], samples[-1], steps + 1)).astype(np.int64)
    return replace(made, frame_sample=at), force[at]


def flow_course(made: Trial, circles: Courses, method: str = "horn-schunck") -> Courses:
    """Mean divergence by a method of `flow.course`, for every step and region."""
    far = _from_axis(made)
    found: dict[str, list[float]] = {name: [] for name in circles}
    for j, step in enumerate(course(made.frames(), method)):
        spreading = divergence(step.field)
        for name, circle in circles.items():
            found[name].append(float(spreading[far < circle[j]].mean(dtype=np.float64)))
    return {name: np.array(values) for name, values in found.items()}


def tracked_course(made: Trial, circles: Courses) -> Courses:
    """The same from pins that are followed: a line through the outward motion of those near the circle."""
    frames = made.frames()
    first = find_pins(next(frames))
    near = NEAR * made.spec.camera.disc_px / made.spec.pins.rings
    places = [first.xy_px, *(pins.xy_px for pins in follow(frames, first))]
    found: dict[str, list[float]] = {name: [] for name in circles if name != "whole"}
    for j, (now, later) in enumerate(pairwise(places)):
        off = now - _middle(made)
        r = np.hypot(*off.T)
        away = ((later - now) * off).sum(axis=1) / np.maximum(r, 1.0)
        for name in found:
            c = circles[name][j]
            here = (np.abs(r - c) < near) & np.isfinite(away)
            found[name].append(float(2 * np.polyfit(r[here] - c, away[here], 1)[1] / c))
    return {name: np.array(values) for name, values in found.items()}


def _middle(made: Trial) -> Float[ndarray, 2]:
    return (made.spec.camera.size_px - 1) / 2 + np.array(made.shift_px)


def _from_axis(made: Trial) -> Float[ndarray, "h w"]:
    y, x = np.mgrid[: made.spec.camera.size_px, : made.spec.camera.size_px]
    at = _middle(made)
    return np.hypot(x - at[0], y - at[1])
