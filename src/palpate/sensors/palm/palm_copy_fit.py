"""Estimate of a palm's copy from pictures of its presses: most probable terms, places and depths.

Least squares on pixels, Gauss and Newton's steps damped as by Levenberg and Marquardt, the copy's prior and
known forces as further rows. Pixels near each other err together, by what the fast rendering leaves out and
the camera's own structure: covariances are those of scores summed over blocks of pixels (cluster-robust;
K.-Y. Liang and S. L. Zeger, Biometrika 73 (1986) 13, doi:10.1093/biomet/73.1.13), added to what the assumed
error of pixels gives: with few blocks, residuals that sixteen unknowns have been fitted to are too small.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from palpate.core import (
    Float,
    ImageError,
    InputError,
    Int,
    Pose,
    Progress,
    RangeError,
    UInt8,
    ndarray,
    silent,
)
from palpate.estimators.known_terms import untold_terms
from palpate.sensors.palm.mirror_view import contact_px
from palpate.sensors.palm.palm_copy import TERMS, CopyFit, PalmCopy, PicturedPress, PressFound, Terms
from palpate.sensors.palm.palm_press import press, table_of
from palpate.sensors.palm.palm_render import housed, render_clean
from palpate.sensors.palm.palm_rim import rim_by_place
from palpate.sensors.palm.palm_spec import PalmSpec

Pixels = Float[ndarray, " n"]
Place = Float[ndarray, " 3"]

STEPS = np.array([0.0, 0.01, 0.01, 2e-3, 5e-3, 0.3, 0.3, 0.2, 0.2, 2e-3, 0.02, 1.0, 0.1, 2e-4, 2e-4, 0.03])
"""Of differences over `TERMS`, x [m], y [m] and ln(depth); a picture does not show E alone."""
FORCE_STEPS = np.array([1e-4, 1e-4, 1e-3])  # of differences of the force over x, y [m] and ln(depth)
SMOOTH = (1, 2, 3, 9, 10, 11)  # that move no edge, so that one side does
BLUR_PX = 1.0  # by which pictures are softened before they are compared
PIXEL_SD = 0.012  # of a pixel, where the pictures themselves do not say more; of white
BLOCK_PX = 6  # side of blocks of pixels that err together
ROUNDS, SETTLED = 20, 0.05  # of the cost, in which 1 is a standard deviation
ASIDE_M = ((0.0, 0.0), (0.0, 2e-3), (0.0, -2e-3))  # y is seen foreshortened, under a dimple that leans
STARTS = 3  # of a press alone, each with another product
DEPTHS = 11  # at which a press is looked for
PRODUCTS = np.linspace(-2.0, 2.0, 7)  # the same, in standard deviations of what is known of the product
MIN_DEPTH_M = 0.15e-3
MAX_OFF = 0.03  # of white, root mean square over a picture: more is another palm's
SEEN = 0.03  # of white, by which the mirror's picture has to change
SURE = 0.03  # spread of the product below which only its mean is looked at
WEIGHT = (PIXEL_SD * BLOCK_PX) ** 2  # of squared pixels: those of a block tell as much as one


@dataclass(frozen=True, eq=False)
class _Seen:
    """A press as the estimate takes it.

    Attributes:
        pixels: of both regions, over white.
        change: of them since the skin was untouched.
        block: to which each belongs.
        press: as it was given.
    """

    pixels: Pixels
    change: Pixels
    block: Int[ndarray, " n"]
    press: PicturedPress


@dataclass(frozen=True, eq=False)
class _State:
    """Terms, and (x [m], y [m], logarithm of the depth in m) of each press."""

    terms: Terms
    places: Float[ndarray, "p 3"]


def fit_copy(known: PalmCopy, presses: Sequence[PicturedPress], progress: Progress = silent) -> CopyFit:
    """Estimate a copy's terms, and place, depth and force of each press.

    Args:
        known: of the copy beforehand.
        presses: pictures, with or without forces; one is a reading, five to ten of known force calibrate.
        progress: called with rounds of the estimate.

    Raises:
        InputError: no press.
        ImageError: a picture of another size, in which no press is seen, or that is no such palm's.
        RangeError: a force that is not above 0.
    """
    if not presses:
        raise InputError("no press; a copy is found from one picture at least")
    seen = [_seen(known.spec, one) for one in presses]
    estimate = _Estimate(known, seen)
    settled = [estimate.settled(state, progress) for state in _first_states(known, seen, progress)]
    found = estimate.fit(min(settled, key=estimate.cost))
    worst = max(one.off for one in found.presses)
    if worst > MAX_OFF:
        raise ImageError(
            f"the nearest picture of this palm differs by {100 * worst:.1f} % of white, and "
            f"{100 * MAX_OFF:g} % are allowed: another palm, another probe, or regions that are not where "
            "the preset has them"
        )
    return found


def read_press(
    known: PalmCopy, image: UInt8[ndarray, "h w 3"], reference: UInt8[ndarray, "h w 3"]
) -> PressFound:
    """Place, depth and force of one picture, its intervals those of the copy as well; see `fit_copy`."""
    return fit_copy(known, [PicturedPress(image, reference)]).presses[0]


def pictured(known: PalmCopy, pose: Pose, *, exact: bool = False) -> Pixels:
    """Both regions of a press as a copy shows them, without noise, sRGB over white, softened, one row."""
    spec = known.looks
    frame = housed(render_clean(press(spec, pose), spec, exact=exact), spec)
    views = (spec.fringes, spec.mirror)
    return np.concatenate([_blurred(_encoded(frame[view.window]), BLUR_PX) for view in views])


def _blurred(image: ndarray, sigma_px: float) -> Pixels:
    """A picture as a row, its hard edges softened, so that it changes smoothly as they move."""
    return cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT).ravel()


def _encoded(linear: ndarray) -> ndarray:
    """SRGB's curve without its rounding (IEC 61966-2-1)."""
    v = np.clip(linear, 0.0, 1.0).astype(np.float64)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * np.maximum(v, 1e-9) ** (1 / 2.4) - 0.055)


def _seen(spec: PalmSpec, one: PicturedPress) -> _Seen:
    for image in (one.image, one.reference):
        if image.shape[:2] != spec.frame_px[::-1]:
            raise ImageError(
                f"a picture of {image.shape[1]} x {image.shape[0]} px; the copy's are {spec.frame_px[0]} x "
                f"{spec.frame_px[1]} px"
            )
    if one.force_n is not None and not (math.isfinite(one.force_n) and one.force_n > 0):
        raise RangeError(f"a known force of {one.force_n} N; it has to be finite and above 0 N")
    if not (math.isfinite(one.force_share) and one.force_share > 0):
        raise RangeError(f"a force known to a share of {one.force_share}; it has to be above 0")
    blocks, first = [], 0
    for view in (spec.fringes, spec.mirror):
        rows, columns = np.indices(view.size_px[::-1]) // BLOCK_PX
        block = first + rows * (columns.max() + 1) + columns
        blocks.append(np.repeat(block.ravel(), 3))
        first = int(block.max()) + 1
    pixels, rest = _pixels(spec, one.image), _pixels(spec, one.reference)
    return _Seen(pixels, pixels - rest, np.concatenate(blocks), one)


def _pixels(spec: PalmSpec, image: UInt8[ndarray, "h w 3"]) -> Pixels:
    parts = (image[view.window] / 255.0 for view in (spec.fringes, spec.mirror))
    return np.concatenate([_blurred(part, BLUR_PX) for part in parts])


def _first_states(known: PalmCopy, seen: Sequence[_Seen], progress: Progress) -> list[_State]:
    """Where to begin: at the few products that all presses together find likeliest.

    A press alone may look alike with another product, depth and place.
    """
    looks = []
    for i, one in enumerate(seen):
        progress("looking for presses", i, len(seen))
        looks.append(_first_looks(known, one))
    together = {product: sum(each[product].score for each in looks) for product in looks[0]}
    likeliest = sorted(together, key=lambda product: together[product])[: STARTS if len(seen) == 1 else 2]
    return [_state_at(known, seen, [each[one].place for each in looks], one) for one in likeliest]


class _Look(NamedTuple):
    """How far the likeliest of a few pictures is from a press, and that picture's place and depth."""

    score: float
    place: Place


def _state_at(known: PalmCopy, seen: Sequence[_Seen], looks: Sequence[Place], product: float) -> _State:
    places, terms = np.stack(looks), known.terms.copy()
    terms[1] += product
    moduli = [
        math.log(one.press.force_n) - _log_unit_force(known.spec, place)[0]
        for one, place in zip(seen, places, strict=True) if one.press.force_n is not None
    ]  # fmt: skip
    if moduli:
        terms[0] = np.median(moduli)
    return _State(terms, places)


def _first_looks(known: PalmCopy, seen: _Seen) -> dict[float, _Look]:
    """Place from where the mirror changes; for every product the likeliest depth of a few."""
    spec = known.looks
    width, height = spec.mirror.size_px
    change = np.abs(seen.change[-height * width * 3 :]).reshape(height, width, 3).mean(axis=2)
    if not change.max() > SEEN:
        raise ImageError("no press is seen in the mirror's view; press deeper, or look at lamp and mirror")
    rows, columns = np.nonzero(change > 0.5 * np.quantile(change, 0.995))
    x, y = seen.press.place_m or _place_of(spec, np.array([np.median(columns), np.median(rows)]) + 0.5)
    asides = ASIDE_M if seen.press.place_m is None else ASIDE_M[:1]
    spread = math.sqrt(known.covariance[1, 1])
    products = PRODUCTS * spread if spread > SURE else np.zeros(1)
    rest = pictured(known, Pose(x, y, 0.0))
    found: dict[float, _Look] = {}
    for depth in np.geomspace(MIN_DEPTH_M, 0.96 * _deepest_m(spec), DEPTHS):
        for product in products:
            for dx, dy in asides:
                terms = known.terms + product * (np.arange(len(TERMS)) == 1)
                at = Pose(x + dx, y + dy, float(depth))
                off = seen.change - (pictured(replace(known, terms=terms), at) - rest)
                score = float(off @ off) / WEIGHT + (product / spread) ** 2
                if float(product) not in found or score < found[float(product)].score:
                    place = np.array([at.x_m, at.y_m, math.log(at.depth_m)])
                    found[float(product)] = _Look(score, place)
    return found


def _place_of(spec: PalmSpec, at_px: Float[ndarray, " 2"]) -> tuple[float, float]:
    """Place on the skin that the mirror shows at a pixel; `contact_px` is linear in it."""
    zero = np.array(contact_px(spec, 0.0, 0.0))
    step = np.array(contact_px(spec, 1e-3, 1e-3)) - zero
    x, y = (at_px - zero) / step * 1e-3
    reach = 0.75 * spec.radius_m
    size = max(math.hypot(x, y) / reach, 1.0)
    return float(x / size), float(y / size)


def _deepest_m(spec: PalmSpec) -> float:
    return table_of(spec).greatest_depth * spec.indenter_radius_m


def _log_unit_force(spec: PalmSpec, place: Place) -> tuple[float, Place]:
    """Ln of the force at the design's modulus [ln N], and its slopes over x, y [1/m] and ln of the depth."""
    table, R = table_of(spec), spec.indenter_radius_m
    steps = np.diag(FORCE_STEPS)
    x, y, log_depth = np.concatenate([place[None], place - steps, place + steps]).T
    depth = np.minimum(np.exp(log_depth) / R, table.greatest_depth)
    by_place = rim_by_place(spec)
    ratio = 1.0 if by_place is None else by_place(x, y, R * depth).ratio
    force = np.log(table.force_at(depth) * spec.youngs_modulus_pa * R**2 * ratio)
    return float(force[0]), (force[4:] - force[1:4]) / (2 * FORCE_STEPS)


class _Estimate:
    """The rows of the least squares, for one set of pictures."""

    def __init__(self, known: PalmCopy, seen: Sequence[_Seen]) -> None:
        self._known, self._seen = known, seen
        self._prior = np.linalg.inv(known.covariance)
        self._size = len(TERMS) + 3 * len(seen)

    def settled(self, state: _State, progress: Progress) -> _State:
        """The most probable state near a first one."""
        damping, cost = 1e-3, self.cost(state)
        for i in range(ROUNDS):
            progress("rounds", i, ROUNDS)
            H, g = self._normal(state)
            while damping < 1e6:
                step = np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
                after = self._moved(state, step)
                new = self.cost(after)
                if new < cost:
                    break
                damping *= 10.0
            else:
                return state
            state, fallen, cost, damping = after, cost - new, new, max(damping / 10.0, 1e-6)
            if fallen < SETTLED:
                return state
        return state

    def fit(self, state: _State) -> CopyFit:
        """The copy and presses of a settled state, with their covariances."""
        H, meat = np.zeros((self._size, self._size)), np.zeros((self._size, self._size))
        off = []
        for at, J, residual, block in self._pixel_rows(state):
            H[np.ix_(at, at)] += J.T @ J / WEIGHT
            scores = np.stack([np.bincount(block, J[:, k] * residual) for k in range(len(at))]) / WEIGHT
            meat[np.ix_(at, at)] += scores @ scores.T
            off.append(math.sqrt(float(residual @ residual) / len(residual)))
        for J, _, weight in self._sure_rows(state):
            H += weight * np.outer(J, J)
        n = len(TERMS)
        H[:n, :n] += self._prior
        bread = np.linalg.inv(H)
        covariance = bread + bread @ meat @ bread  # of pixels' own errors, and of those that blocks share
        copy = PalmCopy(self._known.spec, state.terms, covariance[:n, :n])
        presses = tuple(self._found(state, i, covariance, off[i]) for i in range(len(self._seen)))
        return CopyFit(copy, presses, untold_terms(TERMS, self._known.covariance, copy.covariance))

    def _found(self, state: _State, i: int, covariance: ndarray, off: float) -> PressFound:
        at = len(TERMS) + 3 * i
        x, y, log_depth = state.places[i]
        log_force, slopes = _log_unit_force(self._known.spec, state.places[i])
        towards = np.zeros(self._size)
        towards[0], towards[at : at + 3] = 1.0, slopes
        x_sd, y_sd, depth_sd = np.sqrt(np.diag(covariance)[at : at + 3])
        depth = math.exp(log_depth)
        force_share = math.sqrt(towards @ covariance @ towards)
        force = math.exp(log_force + state.terms[0])
        return PressFound(
            float(x),
            float(y),
            depth,
            force,
            float(x_sd),
            float(y_sd),
            float(depth_sd) * depth,
            force_share,
            off,
        )

    def _normal(self, state: _State) -> tuple[ndarray, ndarray]:
        """Normal matrix, and the cost's descent."""
        H, g, n = np.zeros((self._size, self._size)), np.zeros(self._size), len(TERMS)
        for at, J, residual, _ in self._pixel_rows(state):
            H[np.ix_(at, at)] += J.T @ J / WEIGHT
            g[at] += J.T @ residual / WEIGHT
        for J, away, weight in self._sure_rows(state):
            H += weight * np.outer(J, J)
            g += weight * J * away
        H[:n, :n] += self._prior
        g[:n] += self._prior @ (self._known.terms - state.terms)
        return H, g

    def cost(self, state: _State) -> float:
        """What is left of pixels, forces and places, and how far the terms are from what was known."""
        pixels = 0.0
        for i in range(len(self._seen)):
            left = self._residual(state, i)
            pixels += float(left @ left)
        sure = sum(weight * residual**2 for _, residual, weight in self._sure_rows(state))
        away = state.terms - self._known.terms
        return pixels / WEIGHT + sure + float(away @ self._prior @ away)

    def _residual(self, state: _State, i: int) -> Pixels:
        return self._seen[i].pixels - self._picture(state.terms, state.places[i])

    def _picture(self, terms: Terms, place: Place, *, exact: bool = True) -> Pixels:
        at = Pose(float(place[0]), float(place[1]), math.exp(place[2]))
        return pictured(replace(self._known, terms=terms), at, exact=exact)

    def _pixel_rows(self, state: _State) -> Iterator[tuple[ndarray, ndarray, Pixels, ndarray]]:
        """Rows of each press: its unknowns, slopes of its pixels over them, what is left, and blocks.

        What is left is by the exact way, slopes by the fast one.
        """
        n = len(TERMS)
        for i, one in enumerate(self._seen):
            at = np.concatenate([np.arange(n), n + 3 * i + np.arange(3)])
            slopes = self._slopes(state.terms, state.places[i])
            yield at, slopes, self._residual(state, i), one.block

    def _slopes(self, terms: Terms, place: Place) -> Float[ndarray, "n u"]:
        n, here = len(terms), np.concatenate([terms, place])
        base = self._picture(terms, place, exact=False)
        J = np.zeros((len(base), len(here)))  # of E none: a picture does not show it alone
        for k in range(1, len(here)):
            step = STEPS[k] * (np.arange(len(here)) == k)
            after = self._picture((here + step)[:n], (here + step)[n:], exact=False)
            if k in SMOOTH:
                J[:, k] = (after - base) / STEPS[k]
            else:
                before = self._picture((here - step)[:n], (here - step)[n:], exact=False)
                J[:, k] = (after - before) / (2 * STEPS[k])
        return J

    def _sure_rows(self, state: _State) -> Iterator[tuple[ndarray, float, float]]:
        """Rows of each known force and place: slopes over the unknowns, what is left, and its weight."""
        for i, one in enumerate(seen.press for seen in self._seen):
            first = len(TERMS) + 3 * i
            for k, at in enumerate(one.place_m or ()):
                J = np.zeros(self._size)
                J[first + k] = 1.0
                yield J, at - state.places[i, k], 1 / one.place_sd_m**2
            if one.force_n is not None:
                log_force, slopes = _log_unit_force(self._known.spec, state.places[i])
                J = np.zeros(self._size)
                J[0], J[first : first + 3] = 1.0, slopes
                yield J, math.log(one.force_n) - log_force - state.terms[0], 1 / one.force_share**2

    def _moved(self, state: _State, step: ndarray) -> _State:
        n, spec = len(TERMS), self._known.spec
        places = state.places + step[n:].reshape(-1, 3)
        reach = 0.78 * spec.radius_m
        size = np.maximum(np.hypot(places[:, 0], places[:, 1]) / reach, 1.0)
        places[:, :2] /= size[:, None]
        places[:, 2] = np.clip(places[:, 2], math.log(MIN_DEPTH_M), math.log(0.96 * _deepest_m(spec)))
        return _State(state.terms + step[:n], places)
