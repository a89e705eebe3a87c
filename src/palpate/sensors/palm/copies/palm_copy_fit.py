"""Fit a palm unit to images of its presses.

A rough fit uses few rays and every pixel. Fits with all rays follow, behind the untouched frames' background
and away from edges (`press_picture`), until the edges no longer move.

Palm units on disk, and images of presses from runs and files.

Check of a palm unit by a known weight; an untouched membrane does not show E and C.

The image under the weight gives depth and E C, the weight gives E, and both give C.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from pandas import DataFrame

from palpate.core import (
    Bool,
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
    storage_errors,
)
from palpate.core.errors import MisfitError
from palpate.core.parsing import parser
from palpate.estimators.unit_fit import (
    WEIGHT_SHARE,
    State,
    Widening,
    changed_since,
    cost,
    drifted,
    most_probable,
    read_unit,
    since_fit,
    weight_n,
    write_unit,
)
from palpate.recordings.exchange.image_files import opencv_image
from palpate.recordings.run_reader import Run
from palpate.sensors.palm.copies.copy_estimate import MIN_DEPTH_M, CopyEstimate, deepest_m, joined, log_force
from palpate.sensors.palm.copies.palm_copy import (
    AT,
    LOCAL,
    PIXEL_SD,
    TERMS,
    CopyFit,
    PalmCopy,
    PicturedPress,
    PressFound,
    designed_copy,
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
from palpate.sensors.palm.palm_sensor import Palm
from palpate.sensors.palm.palm_spec import PalmSpec, preset

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


FORMAT = "palpate palm copy 3"
MIN_SHARE = 0.1  # minimum force of a press over the run's maximum
MAX_REACH = (
    0.7  # maximum distance from the axis over the radius; images near the rim are not modeled well enough
)

Image = UInt8[ndarray, "h w 3"]


def write_copy(copy: PalmCopy, design: str, path: Path) -> None:
    """Write a unit as JSON."""
    others = {
        "preset": design, "frame_px": list(copy.spec.frame_px), "friction": copy.spec.friction,
        "widening": copy.widening._asdict(),
        "local_spreads": dict(zip(LOCAL[3:], copy.local_spreads, strict=True)),
    }  # fmt: skip
    write_unit(path, FORMAT, TERMS, copy.terms, copy.covariance, others)


@parser("palm unit", InputError)
def read_copy(path: Path) -> PalmCopy:
    """Read a unit written by `write_copy`."""
    return read_unit(path, FORMAT, TERMS, "palpate calibrate --method palm-unit", _made)


def _made(record: dict[str, Any], terms: ndarray, covariance: ndarray) -> PalmCopy:
    width, height = (int(one) for one in record["frame_px"])
    wider = Widening(**record["widening"])
    widening = Widening(float(wider.place), float(wider.depth), float(wider.force), int(wider.presses))
    own = tuple(float(record["local_spreads"][name]) for name in LOCAL[3:])
    spec = design_for(str(record["preset"]), (height, width), float(record["friction"])).spec
    if not all(math.isfinite(one) and one > 0 for one in own):
        raise ValueError(f"spreads of one press, {own}, have to be above 0")
    if not all(math.isfinite(one) and one >= 1 for one in widening[:3]):
        raise ValueError(f"{widening} makes intervals narrower")
    return PalmCopy(spec, terms, covariance, widening, own)


def design_for(name: str, frame_px: tuple[int, int], friction: float = 0.0) -> PalmCopy:
    """Return a preset's design for frames (height, width), full size or as on a virtual rig."""
    spec = preset(name)
    on_rig = Palm(spec).for_rig().spec
    for one in (spec, on_rig):
        if one.frame_px == frame_px[::-1]:
            return designed_copy(_with_friction(one, friction))
    raise ImageError(
        f"frames of {frame_px[1]} x {frame_px[0]} px; the preset {name} has {spec.frame_px[0]} x "
        f"{spec.frame_px[1]} px, on a virtual rig {on_rig.frame_px[0]} x {on_rig.frame_px[1]} px",
        code="frame-size",
    )


def preset_radius_m(name: str) -> float:
    """Return the membrane radius of a preset [m]."""
    return preset(name).radius_m


def preset_ball(name: str) -> str:
    """Return the indenter name of a preset's ball."""
    return Palm(preset(name)).default_probe


def _with_friction(spec: PalmSpec, friction: float) -> PalmSpec:
    if friction not in (0.0, 0.5):
        raise RangeError(f"friction {friction:g}; presses were solved for 0 and for 0.5")
    return replace(spec, friction=friction)


def pictured_presses(
    path: Path, count: int, force_share: float, within_m: float = math.inf, ball: str = ""
) -> list[PicturedPress]:
    """Return frames of a run with evenly ranked forces above a tenth of the maximum, with their references.

    Args:
        path: Run.
        count: Number of frames.
        force_share: Relative standard deviation of the forces.
        within_m: Maximum distance from the membrane's axis [m].
        ball: Indenter to select; any if empty. Frames of lateral loads are excluded.
    """
    run = Run.open(path)
    table = run.labels
    wanted = ("force_N", "press", "reference", "x_mm", "y_mm")
    if missing := [name for name in wanted if name not in table]:
        raise InputError(f"{path} has no label {', '.join(missing)}; a copy needs {', '.join(wanted)}")
    is_rest = table["reference"].astype(bool).to_numpy()
    rests = {press: int(i) for i, press in zip(np.flatnonzero(is_rest), table["press"][is_rest], strict=True)}
    force = table["force_N"].to_numpy(float)
    places = 1e-3 * table[["x_mm", "y_mm"]].to_numpy(float)
    straight = ~is_rest & _is_of(table, ball, path)
    most_n = np.max(force, initial=0.0, where=straight & np.isfinite(force))
    if straight.any() and not most_n > 0:
        raise InputError(f"no force of {path} is above 0 N; compression is positive", code="force-sign")
    able = straight & (force > MIN_SHARE * most_n)
    able &= np.hypot(*places.T) <= within_m
    rows = [int(i) for i in np.flatnonzero(able) if table["press"][i] in rests]
    if not 1 <= count <= len(rows):
        near = f" within {1e3 * within_m:.3g} mm of the middle" if math.isfinite(within_m) else ""
        raise InputError(f"{count} presses of {len(rows)} usable frames{near}", code="press-count")
    rows.sort(key=lambda i: force[i])
    chosen = [rows[round(k)] for k in np.linspace(0, len(rows) - 1, count)]
    return [
        PicturedPress(
            run.frame(i).image, run.frame(rests[table["press"][i]]).image, float(force[i]), force_share,
            (float(places[i, 0]), float(places[i, 1])),
        )
        for i in chosen
    ]  # fmt: skip


def _is_of(table: DataFrame, ball: str, path: Path) -> Bool[ndarray, " n"]:
    """Frames of straight presses by the ball."""
    own = np.ones(len(table), bool)
    if ball and "indenter" in table:
        own = (table["indenter"].astype(str) == ball).to_numpy()
        if not own.any():
            others = ", ".join(sorted(set(table["indenter"].astype(str))))
            raise InputError(f"{path} was pressed by {others}, not by {ball}", code="indenter-differs")
    return own & (table["phase"] != "lateral").to_numpy() if "phase" in table else own


@parser("palm picture", ImageError, max_bytes=1 << 30)
def read_picture(path: Path) -> Image:
    """Read an image file as 8-bit color."""
    with storage_errors(path):
        data = np.frombuffer(path.read_bytes(), np.uint8)
    image = opencv_image(data, cv2.IMREAD_COLOR)
    if image is None:
        raise ImageError(f"{path} is no picture that can be read; give a PNG")
    return np.ascontiguousarray(image[..., ::-1], dtype=np.uint8)


STILL_M, SAID_MOVED = 0.1e-3, 3.0  # maximum motion of a weight at rest, plus standard deviations
FLOOR = 0.01  # minimum relative uncertainty of E and C


@dataclass(frozen=True, slots=True)
class WeightCheck:
    """Result of a weight check of a calibrated unit.

    Attributes:
        force_n: Weight [N].
        read_n: Force read from the image with the calibrated C [N].
        modulus_change, coefficient_change: Relative changes since the calibration.
        modulus_deviations, coefficient_deviations: Changes in standard deviations.
    """

    force_n: float
    read_n: float
    modulus_change: float
    coefficient_change: float
    modulus_deviations: float
    coefficient_deviations: float

    @property
    def drifted(self) -> tuple[str, ...]:
        """Names of the changed constants."""
        return drifted({"modulus": self.modulus_deviations, "coefficient": self.coefficient_deviations})


def check_weight(
    calibrated: PalmCopy, image: UInt8[ndarray, "h w 3"], reference: UInt8[ndarray, "h w 3"], mass_kg: float,
    progress: Progress = silent,
) -> tuple[WeightCheck, CopyFit]:  # fmt: skip
    """Compare a calibrated unit with an object of known mass that rests on the palm's ball.

    Args:
        calibrated: Unit.
        image, reference: Frames under the weight at rest and untouched.
        mass_kg: Total mass on the membrane including the ball [kg].
        progress: Callback for the rounds.

    Returns:
        Check, and the unit whose E and C follow from this weight alone.
    """
    force_n = weight_n(mass_kg)
    design = designed_copy(calibrated.spec)
    now, freedom = since_fit(calibrated.covariance, design.covariance, 2)
    unchanged = fit_copy(calibrated, [PicturedPress(image, reference)], progress)
    weighed = [PicturedPress(image, reference, force_n, WEIGHT_SHARE)]
    known = replace(calibrated, covariance=now + freedom)
    found = fit_copy(known, weighed, progress, near=unchanged)
    away, spread = changed_since(found.copy.terms - calibrated.terms, freedom, now, found.copy.covariance)
    towards = np.array([[1.0, 0.0], [-1.0, 1.0]])  # ln E, ln C
    change, spread = towards @ away[:2], towards @ spread[:2, :2] @ towards.T
    deviations = change / np.sqrt(np.diag(spread) + FLOOR**2)
    shares = np.expm1(change)
    read_n = found.presses[0].force_n * math.exp(float(change[1]))  # E C is visible, C is the calibrated one
    return WeightCheck(
        force_n, read_n, float(shares[0]), float(shares[1]), float(deviations[0]), float(deviations[1])
    ), found


def refuse_rolling(
    found: CopyFit, image: UInt8[ndarray, "h w 3"], later: UInt8[ndarray, "h w 3"],
    reference: UInt8[ndarray, "h w 3"], progress: Progress = silent,
) -> None:  # fmt: skip
    """Reject a weight that has moved some seconds later, since a push or slope carries part of it.

    Args:
        found: Unit from `check_weight`.
        image, later: First and later frame of the weight.
        reference: Untouched frame.
        progress: Callback for the rounds.
    """
    if np.array_equal(image, later):
        raise InputError("both pictures of the weight are the same; take the later one some seconds after")
    first = found.presses[0]
    then = fit_copy(found.copy, [PicturedPress(later, reference)], progress).presses[0]
    for name in ("x", "y"):
        moved = getattr(then, f"{name}_m") - getattr(first, f"{name}_m")
        spread = math.hypot(getattr(first, f"{name}_sd_m"), getattr(then, f"{name}_sd_m"))
        if abs(moved) > STILL_M + SAID_MOVED * spread:
            raise InputError(
                f"the weight has moved by {1e3 * moved:+.2f} mm along {name} between both pictures, and "
                f"{1e3 * (STILL_M + SAID_MOVED * spread):.2f} mm are allowed: let it come to rest on a level "
                "skin, and take both pictures anew"
            )
