"""Fit a palm unit to images of its presses.

A rough fit uses few rays and every pixel. Fits with all rays follow, behind the untouched frames' background
and away from edges (`press_picture`), until the edges no longer move.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from palpate.core import (
    Drift,
    Float,
    ImageError,
    InputError,
    Pose,
    Progress,
    RangeError,
    UInt8,
    ndarray,
    silent,
)
from palpate.core.errors import MisfitError
from palpate.estimators.unit_fit import State, cost, most_probable
from palpate.sensors.palm.copies.copy_estimate import MIN_DEPTH_M, CopyEstimate, joined
from palpate.sensors.palm.copies.copy_force import deepest_m, log_force
from palpate.sensors.palm.copies.palm_copy import (
    AT,
    LOCAL,
    PIXEL_SD,
    TERMS,
    CopyFit,
    PalmCopy,
    PicturedPress,
    PressFound,
)
from palpate.sensors.palm.copies.press_picture import (
    BLOCK_PX,
    Pixels,
    SeenPress,
    away_from_edges,
    backdrop_of,
    lamp_of,
    pictured,
    regions_of,
    seen_press,
)
from palpate.sensors.palm.mirror_view import contact_px
from palpate.sensors.palm.palm_spec import PalmSpec

Place = Float[ndarray, " 3"]

ASIDE_M = ((0.0, 0.0), (0.0, 2e-3), (0.0, -2e-3))  # y is foreshortened
STARTS = 3  # start states of a single press
TRIED = 2  # rounds before the likelier start is chosen
ROUGH = 4  # further rounds with few rays
PASSES = 3  # maximum fits with all rays
MOVED = 0.3  # change of depth that requires another fit, in rows
DEPTHS = 11  # depths in the search for a press
PRODUCTS = np.linspace(-2.0, 2.0, 7)  # products in the search, in prior standard deviations
LAMP_SD = 0.02  # day-to-day standard deviation of the log lamp
DRIFTED = 3.0  # standard deviations
MAX_MISFIT = 1.7  # maximum misfit of a reading, in pixel standard deviations
MAX_OFF = 0.03  # maximum rms difference of an image over white; more is another palm
FARTHEST = 5.0  # maximum change of E and C in prior standard deviations
SEEN = 0.015  # minimum change of the mirror's image over white; noise alone is 0.012
SURE = 0.03  # spread of the product below which only its mean is searched
LIT = 0.03  # spread of the lamp below which the untouched frame is compared with the prior
WEIGHT = (PIXEL_SD * BLOCK_PX) ** 2


def fit_copy(
    known: PalmCopy, presses: Sequence[PicturedPress], progress: Progress = silent,
    near: CopyFit | None = None,
) -> CopyFit:  # fmt: skip
    """Estimate a unit's terms, and position, depth, and force of each press.

    Args:
        known: Prior of the unit.
        presses: Images with or without forces; one is a reading, five to ten of known force calibrate.
        progress: Callback for the rounds.
        near: Another fit of the same presses as an additional start; the likelier result is kept.
    """
    if not presses:
        raise InputError("no press; a copy is found from one picture at least", code="no-presses")
    seen = [seen_press(known.spec, one) for one in presses]
    states, row_m = [_rough_state(known, seen, progress)], known.spec.fringes.pitches_m[1]
    if near is not None:
        states.append(_state_of(near, seen))
    for _ in range(PASSES):
        edges, estimate = states[0], _estimate_at(known, seen, states[0])
        ends = (most_probable(estimate, one, progress) for one in states)
        states = [min(ends, key=partial(cost, estimate))]
        depths = [np.exp(_local(one)[:, 2]) for one in (states[0], edges)]
        if np.abs(depths[0] - depths[1]).max() < MOVED * row_m:
            break
    found = estimate.fit(states[0])
    worst = max(one.off for one in found.presses)
    if worst > MAX_OFF:
        raise ImageError(
            f"the nearest picture of this palm differs by {100 * worst:.1f} % of white, and "
            f"{100 * MAX_OFF:g} % are allowed: another palm, another probe, or regions that are not where "
            "the preset has them"
        )
    if any(one.force_n is not None for one in presses):
        refuse_far(known, found.copy)
    return found


def refuse_far(known: PalmCopy, found: PalmCopy) -> None:
    """Reject a unit whose E or C is far from the prior, as by forces in a wrong unit."""
    E = found.modulus_pa / known.modulus_pa
    C = found.coefficient_per_pa / known.coefficient_per_pa
    allowed = [math.exp(FARTHEST * one) for one in (known.modulus_share, known.coefficient_share)]
    if all(abs(math.log(ratio)) <= math.log(most) for ratio, most in zip((E, C), allowed, strict=True)):
        return
    raise RangeError(
        f"by these forces E is {E:.3g} and C {C:.3g} times what was known of this palm, where a factor of "
        f"{allowed[0]:.2g} and {allowed[1]:.2g} is allowed: is every force in N, every mass in g, and the "
        "preset of this palm's material?"
    )


def read_press(
    known: PalmCopy, image: UInt8[ndarray, "h w 3"], reference: UInt8[ndarray, "h w 3"]
) -> PressFound:
    """Return position, depth, and force of one image, with intervals that include the unit's uncertainty."""
    found = fit_copy(known, [PicturedPress(image, reference)]).presses[0]
    refuse_misfit(found)
    return found


def refuse_misfit(found: PressFound) -> None:
    """Reject a reading whose misfit exceeds that of presses of the palm's ball."""
    if found.misfit > MAX_MISFIT:
        raise MisfitError(
            f"the picture differs from this palm's own by {found.off:.1%} of white, and "
            f"{MAX_MISFIT * PIXEL_SD:.1%} is allowed; read presses of the palm's own ball with its own copy"
        )


def drift_of(known: PalmCopy, reference: UInt8[ndarray, "h w 3"]) -> Drift:
    """Return the change of the lamp since the fit, in standard deviations; E and C are not
    visible at rest.
    """
    change = lamp_of(known, [regions_of(known.spec, reference)])
    spread = math.hypot(math.sqrt(known.covariance[AT["lamp"], AT["lamp"]]), LAMP_SD)
    return Drift(abs(change) / spread, DRIFTED)


def _rough_state(known: PalmCopy, seen: Sequence[SeenPress], progress: Progress) -> State:
    """Most probable state by few rays and every pixel."""
    sure, rests = math.sqrt(known.covariance[AT["lamp"], AT["lamp"]]) <= LIT, [one.rest for one in seen]
    lit = 0.0 if sure else lamp_of(known, rests)
    first = _first_states(replace(known, terms=known.terms + lit * _unit("lamp")), seen, progress)
    few = replace(known, spec=replace(known.spec, rays_per_pixel=(1, 1)))
    backdrop = backdrop_of(few, rests, _places(first[0])) if sure else None
    rough = CopyEstimate(few, seen, backdrop)
    tried = (most_probable(rough, state, progress, rounds=TRIED) for state in first)
    return most_probable(rough, min(tried, key=partial(cost, rough)), progress, rounds=ROUGH)


def _estimate_at(known: PalmCopy, seen: Sequence[SeenPress], state: State) -> CopyEstimate:
    """Estimate with all rays, with background and edges of a state."""
    at = replace(known, terms=state[: len(TERMS)])
    backdrop = backdrop_of(at, [one.rest for one in seen], _places(state))
    return CopyEstimate(known, seen, backdrop, [away_from_edges(at, own) for own in _local(state)])


def _places(state: State) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in _local(state)[:, :2]]


def _local(state: State) -> Float[ndarray, "p 8"]:
    return state[len(TERMS) :].reshape(-1, len(LOCAL))


def _state_of(fit: CopyFit, seen: Sequence[SeenPress]) -> State:
    """State at which another fit of the same presses ended."""
    local = np.zeros((len(seen), len(LOCAL)))
    for own, one, found in zip(local, seen, fit.presses, strict=True):
        own[:4] = found.x_m, found.y_m, math.log(found.depth_m), one.exposure
    return joined(fit.copy.terms, local)


def _first_states(known: PalmCopy, seen: Sequence[SeenPress], progress: Progress) -> list[State]:
    """Start states at the most likely products of all presses."""
    looks = []
    for i, one in enumerate(seen):
        progress("looking for presses", i, len(seen))
        looks.append(_first_looks(known, one))
    together = {product: sum(each[product].score for each in looks) for product in looks[0]}
    likeliest = sorted(together, key=lambda product: together[product])[: STARTS if len(seen) == 1 else 2]
    return [_state_at(known, seen, [each[one].place for each in looks], one) for one in likeliest]


class _Look(NamedTuple):
    """Misfit of the best of a few images, with its position and depth."""

    score: float
    place: Place


def _state_at(known: PalmCopy, seen: Sequence[SeenPress], looks: Sequence[Place], product: float) -> State:
    terms = known.terms + product * _unit("product")
    local = np.zeros((len(seen), len(LOCAL)))
    local[:, :3], local[:, 3] = looks, [one.exposure for one in seen]
    moduli = [
        known.terms[0] + math.log(one.press.force_n) - log_force(known, own)[0]
        for one, own in zip(seen, local, strict=True) if one.press.force_n is not None
    ]  # fmt: skip
    if moduli:
        terms[0] = np.median(moduli)
    return joined(terms, local)


def _first_looks(known: PalmCopy, seen: SeenPress) -> dict[float, _Look]:
    """Position where the mirror changes, and for each product the most likely depth."""
    spec = known.looks
    width, height = spec.mirror.size_px
    change = np.abs(seen.change[-height * width * 3 :]).reshape(height, width, 3).mean(axis=2)
    if not change.max() > SEEN:
        raise ImageError("no press is seen in the mirror; press deeper", code="press-not-seen")
    rows, columns = np.nonzero(change > 0.5 * np.quantile(change, 0.995))
    x, y = seen.press.place_m or _place_of(spec, np.array([np.median(columns), np.median(rows)]) + 0.5)
    asides = ASIDE_M if seen.press.place_m is None else ASIDE_M[:1]
    spread = math.sqrt(known.covariance[1, 1])
    products = PRODUCTS * spread if spread > SURE else np.zeros(1)
    rest = _exposed(known, Pose(x, y, 0.0), seen)
    found: dict[float, _Look] = {}
    for depth in np.geomspace(MIN_DEPTH_M, 0.96 * deepest_m(spec), DEPTHS):
        for product in products:
            for dx, dy in asides:
                terms = known.terms + product * _unit("product")
                at = Pose(x + dx, y + dy, float(depth))
                off = seen.change - (_exposed(replace(known, terms=terms), at, seen) - rest)
                score = float(off @ off) / WEIGHT + (product / spread) ** 2
                if float(product) not in found or score < found[float(product)].score:
                    place = np.array([at.x_m, at.y_m, math.log(at.depth_m)])
                    found[float(product)] = _Look(score, place)
    return found


def _exposed(known: PalmCopy, at: Pose, seen: SeenPress) -> Pixels:
    return pictured(replace(known, terms=known.terms + seen.exposure * _unit("lamp")), at)


def _unit(name: str) -> Float[ndarray, " t"]:
    return (np.arange(len(TERMS)) == AT[name]).astype(float)


def _place_of(spec: PalmSpec, at_px: Float[ndarray, " 2"]) -> tuple[float, float]:
    """Position on the membrane of a mirror pixel; `contact_px` is linear."""
    zero = np.array(contact_px(spec, 0.0, 0.0))
    step = np.array(contact_px(spec, 1e-3, 1e-3)) - zero
    x, y = (at_px - zero) / step * 1e-3
    reach = 0.75 * spec.radius_m
    size = max(math.hypot(x, y) / reach, 1.0)
    return float(x / size), float(y / size)
