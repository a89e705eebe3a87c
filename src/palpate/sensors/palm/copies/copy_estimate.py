"""Forward model of a palm's presses for `estimators.unit_fit`: pixels, known forces, and positions.

Pixels are weighted robustly, against unmodeled dirt and reflections; pixels of a block are correlated.

Uncertainty of E and C after a unit's presses: dominant term, and most informative further press.

Force of a unit's press, and its derivatives by the unit's terms and the press's unknowns.

Derivatives of a press's image by the unit's terms and the press's unknowns, by finite differences.

Depth, thickness, and the product E C nearly compensate each other, so their derivatives use all rays; those
of lamp, polariser, and lens use the fast rendering.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from palpate.core import Float, Progress, ndarray, silent
from palpate.estimators.unit_fit import (
    Block,
    KnownRow,
    Layout,
    Posterior,
    State,
    covariance_with,
    posterior,
    standardised,
    untold_terms,
    widening_of,
)
from palpate.mechanics.axisymmetric.disc_table import DiscTable
from palpate.sensors.palm.copies.palm_copy import (
    AT,
    LOCAL,
    MODES,
    PARTS,
    PIXEL_SD,
    RESIDUAL_MODES,
    TERMS,
    CopyFit,
    Local,
    PalmCopy,
    PressFound,
    Terms,
    harder_at,
)
from palpate.sensors.palm.copies.press_picture import (
    BLOCK_PX,
    Backdrop,
    Kept,
    Pixels,
    SeenPress,
    away_from_edges,
    shown,
)
from palpate.sensors.palm.fringe_view import columns_kept
from palpate.sensors.palm.membrane_faults import side_modes
from palpate.sensors.palm.palm_press import has_table, table_of
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.press_corrections import rim_by_place

STEPS = np.array([1e-4, 1e-4, 1e-3])  # finite-difference steps of x, y [m], and ln(depth)
THICKER = 0.03  # step of log thickness between the tables


def log_force(known: PalmCopy, local: Local) -> tuple[float, Float[ndarray, " u"]]:
    """Return the logarithm of a press's force [ln N] and its derivatives by `TERMS` and `LOCAL`."""
    spec, n = known.spec, len(TERMS)
    thicker = float(known.terms[AT["thickness"]] + local[5])
    places = local[:3] + np.concatenate([np.zeros((1, 3)), -np.diag(STEPS), np.diag(STEPS)])
    even, slope = _even(spec, places, thicker)
    J = np.zeros(n + len(local))
    J[n : n + 3] = (even[4:] - even[1:4]) / (2 * STEPS)
    J[[0, n + 4]] = 1.0
    J[[AT["thickness"], n + 5]] = slope
    across, along = AT["harder_across"], AT["harder_along"]
    J[[across, along]] = local[:2] / spec.radius_m
    J[n : n + 2] += known.terms[[across, along]] / spec.radius_m
    return float(even[0] + known.terms[0] + harder_at(known, local)), J


def deepest_m(spec: PalmSpec) -> float:
    """Return the maximum depth of the design's table [m]."""
    return table_of(spec).greatest_depth * spec.indenter_radius_m


def thickness_is_free(spec: PalmSpec) -> bool:
    """Return whether slightly thinner and thicker membranes are tabled."""
    return len(_tables(spec)) == 3


def _even(
    spec: PalmSpec, places: Float[ndarray, "p 3"], thicker: float
) -> tuple[Float[ndarray, " p"], float]:
    """Log force on the design's modulus, and the first one's derivative by log thickness."""
    x, y, log_depth = places.T
    depth, R = np.exp(log_depth), spec.indenter_radius_m
    by_place = rim_by_place(spec)
    ratio = 1.0 if by_place is None else by_place(x, y, depth).ratio
    unit = np.log(spec.youngs_modulus_pa * R**2 * ratio)
    logs = [np.log(one.force_at(np.minimum(depth / R, one.greatest_depth))) for one in _tables(spec)]
    if len(logs) == 1:
        return logs[0] + unit, 0.0
    thin, own, thick = logs
    first, second = (thick - thin) / (2 * THICKER), (thick + thin - 2 * own) / THICKER**2
    return unit + own + thicker * (first + thicker * second / 2), float(first[0] + thicker * second[0])


@lru_cache(maxsize=8)
def _tables(spec: PalmSpec) -> tuple[DiscTable, ...]:
    """Table of the design, between the next thinner and thicker ones if they exist."""
    beside = [replace(spec, thickness_m=spec.thickness_m * math.exp(off)) for off in (-THICKER, THICKER)]
    if not all(has_table(replace(spec, thickness_m=spec.thickness_m * s)) for s in (0.92, 1.09)):
        return (table_of(spec),)
    return table_of(beside[0]), table_of(spec), table_of(beside[1])


ONE_SIDED = {
    "lamp": 0.01, "polariser_rad": 2e-3, "ambient": 2e-3, "corner_loss": 0.02, "mired": 1.0,
}  # fmt: skip
EXACT = {
    "elevation_rad": 5e-3, "mirror_across_px": 0.25, "mirror_down_px": 0.25, "mirror_scale": 5e-3,
    "mirror_turn_rad": 5e-3, "fringes_turn_rad": 3e-3, "fringes_across_px": 0.3, "fringes_down_px": 0.3,
    "fringes_scale": 5e-3, "residual_along": 0.01, "residual_aside": 0.01,
}  # fmt: skip
ALL_RAYS = {"product": 0.01, "thickness": 0.01}
PLACE_STEPS = (3e-4, 3e-4, 0.02)  # of x, y [m] and ln(depth)
MIN_BLUR_PX = 0.15
NEAR = {
    "product": 0.03, "lamp": 0.1, "polariser_rad": 0.01, "elevation_rad": 0.01, "thickness": 0.01,
    "blur_px": 0.15,
}  # fmt: skip
NEAR_LOCAL = (1e-4, 1e-4, 0.02)
"""Changes of terms, and of position [m] and ln(depth), within which derivatives are reused."""


def picture_slopes(
    known: PalmCopy, local: Local, backdrop: Backdrop | None, kept: Kept | None = None
) -> Float[ndarray, "n u"]:
    """Return pixel derivatives by `TERMS` and `LOCAL`; 0 by E, which an image does not show alone."""
    draw = partial(shown, backdrop=backdrop, kept=kept)
    few = replace(known, spec=replace(known.spec, rays_per_pixel=(1, 1)))  # few rays suffice for most terms
    clean = known.terms.copy()
    clean[[i for name, i in AT.items() if name.startswith("residual")]] = 0.0
    clean[AT["blur_px"]] = max(clean[AT["blur_px"]], MIN_BLUR_PX)
    own = local.copy()
    own[LOCAL.index("residual_along") :] = 0.0

    def fast(name: str, step: float) -> Pixels:
        return draw(replace(few, terms=clean + step * _unit(name)), own, exact=False)

    def between(copy: PalmCopy, name: str, step: float) -> Pixels:
        ends = (draw(replace(copy, terms=copy.terms + s * step * _unit(name)), local) for s in (1, -1))
        return np.asarray((next(ends) - next(ends)) / (2 * step))

    base = fast("lamp", 0.0)
    J = np.zeros((len(base), len(TERMS) + len(LOCAL)))
    for name, step in ONE_SIDED.items():
        J[:, AT[name]] = (fast(name, step) - base) / step
    J[:, AT["blur_px"]] = (fast("blur_px", 0.1) - fast("blur_px", -0.1)) / 0.2
    for copy, steps in ((few, EXACT), (known, ALL_RAYS)):
        for name, step in steps.items():
            if name != "thickness" or thickness_is_free(known.spec):
                J[:, AT[name]] = between(copy, name, step)
    n = len(TERMS)
    for k, step in enumerate(PLACE_STEPS):
        off = step * (np.arange(len(LOCAL)) == k)
        at = known if LOCAL[k] == "log_depth" else few  # nearly cancels with the product
        J[:, n + k] = (draw(at, local + off) - draw(at, local - off)) / (2 * step)
    longer = own + 0.01 * (np.arange(len(LOCAL)) == 3)
    J[:, n + 3] = (draw(replace(few, terms=clean), longer, exact=False) - base) / 0.01
    shared = ("product", "thickness", "residual_along", "residual_aside")
    J[:, n + 4 : n + 8] = J[:, [AT[name] for name in shared]]
    over_view = _modes_at(known, local)
    for part in PARTS:
        J[:, [AT[one] for one in RESIDUAL_MODES[part]]] = over_view * J[:, [AT[f"residual_{part}"]]]
    for k, name in enumerate(("harder_across", "harder_along")):
        J[:, AT[name]] = J[:, AT["product"]] * local[k] / known.spec.radius_m
    return J


def _modes_at(known: PalmCopy, local: Local) -> Float[ndarray, "n m"]:
    """Modes of the residual birefringence at every pixel; 0 in the mirror."""
    spec = known.under(local).looks
    view, h = spec.fringes, spec.thickness_m
    across = columns_kept(spec.unlit).impact_m / spec.radius_m
    across, down = np.broadcast_arrays(
        np.nan_to_num(across), np.clip(2 * view.down_m[:, None] / h - 1, -1, 1)
    )
    modes = side_modes(across, down)[:MODES].reshape(MODES, -1)
    mirror = np.zeros((3 * spec.mirror.size_px[0] * spec.mirror.size_px[1], MODES))
    return np.concatenate([np.repeat(modes.T, 3, axis=0), mirror])


def _unit(name: str) -> Float[ndarray, " t"]:
    return (np.arange(len(TERMS)) == AT[name]).astype(float)


def still_near(one: tuple[ndarray, Local], other: tuple[ndarray, Local]) -> bool:
    """Return whether derivatives at one state are valid at another."""
    terms = all(abs(one[0][AT[name]] - other[0][AT[name]]) <= away for name, away in NEAR.items())
    return terms and bool(np.all(np.abs(one[1][:3] - other[1][:3]) <= NEAR_LOCAL))


ROBUST = 3.0  # standard deviations from which a pixel's weight decreases
PRESS_SD = PIXEL_SD * BLOCK_PX  # standard deviation of a pixel when a block counts as one
MIN_DEPTH_M = 0.15e-3
MAX_THICKER = 0.055  # limit of the logarithm of a unit's thickness over the design's
MAX_THICKER_HERE = 0.02  # limit of a press's over the unit's
REACH = 0.78  # search radius of a press over the membrane's radius


class CopyEstimate:
    """A palm's presses as a `UnitModel`."""

    kink = ROBUST / BLOCK_PX

    def __init__(
        self, known: PalmCopy, seen: Sequence[SeenPress], backdrop: Backdrop | None = None,
        kept: Sequence[Kept] | None = None,
    ) -> None:  # fmt: skip
        self._known, self._seen, self._backdrop = known, seen, backdrop
        self._masks = [None] * len(seen) if kept is None else kept
        self._pixels = [one.kept(mask) for one, mask in zip(seen, self._masks, strict=True)]
        self.layout = Layout(len(TERMS), len(LOCAL), len(seen))
        own = np.zeros((len(seen), len(LOCAL)))
        own[:, 3] = [one.exposure for one in seen]
        self.mean = joined(known.terms, own)
        self.precision = np.zeros((self.layout.size,) * 2)
        self.precision[: len(TERMS), : len(TERMS)] = np.linalg.inv(known.covariance)
        after = np.arange(len(TERMS), self.layout.size)
        sure = [0.0, 0.0, 0.0, *(1 / one**2 for one in known.local_spreads)]
        self.precision[after, after] = np.tile(sure, len(seen))
        self._slopes_at: dict[int, tuple[tuple[Terms, Local], ndarray]] = {}
        self._left: dict[int, list[tuple[bytes, Pixels]]] = {}

    def residuals(self, state: State) -> Iterator[tuple[Pixels, float]]:
        for i in range(len(self._seen)):
            yield self._residual(state, i), PRESS_SD

    def blocks(self, state: State) -> Iterator[Block]:
        for i, one in enumerate(self._seen):
            at, slopes = self.layout.at(i), self._slopes(state, i)
            yield Block(at, slopes, self._residual(state, i), PRESS_SD, one.block)

    def known(self, state: State) -> list[KnownRow]:
        rows, own = [], self.layout.own_of(state)
        for i, one in enumerate(seen.press for seen in self._seen):
            first = len(TERMS) + len(LOCAL) * i
            for k, at in enumerate(one.place_m or ()):
                J = (np.arange(self.layout.size) == first + k).astype(float)
                rows.append(KnownRow(J, at - float(own[i, k]), 1 / one.place_sd_m**2, i, False))
            if one.force_n is not None:
                force, slopes = log_force(self._copy(state), own[i])
                J = self.layout.row(i, slopes)
                rows.append(KnownRow(J, math.log(one.force_n) - force, 1 / one.force_share**2, i, True))
        return rows

    def inside(self, state: State) -> State:
        state, spec, thick = state.copy(), self._known.spec, AT["thickness"]
        local = self.layout.own_of(state)
        size = np.maximum(np.hypot(local[:, 0], local[:, 1]) / (REACH * spec.radius_m), 1.0)
        local[:, :2] /= size[:, None]
        local[:, 2] = np.clip(local[:, 2], math.log(MIN_DEPTH_M), math.log(0.96 * deepest_m(spec)))
        local[:, 5] = np.clip(local[:, 5], -MAX_THICKER_HERE, MAX_THICKER_HERE)
        state[thick] = np.clip(state[thick], -MAX_THICKER, MAX_THICKER)
        return state

    def fit(self, state: State) -> CopyFit:
        """Return unit and presses of a converged state, with covariances."""
        n, found = len(TERMS), posterior(self, state)
        depths = [n + len(LOCAL) * i + 2 for i in range(len(self._seen))]
        held = {one.press for one in found.known if one.is_force}
        widening = self._known.widening
        if held:
            errors = standardised(found.hessian, found.meat, found.known, depths)
            widening = widening_of(errors, len(held))
        copy = replace(
            self._known, terms=state[:n].copy(), covariance=found.covariance[:n, :n], widening=widening
        )
        presses = tuple(self._found(found, i) for i in range(len(self._seen)))
        untold = untold_terms(TERMS, self._known.covariance, copy.covariance)
        maps = {one for names in RESIDUAL_MODES.values() for one in names}  # many, each of little account
        return CopyFit(copy, presses, tuple(one for one in untold if one not in maps))

    def _found(self, found: Posterior, i: int) -> PressFound:
        at, local = len(TERMS) + len(LOCAL) * i, self.layout.own_of(found.state)[i]
        wider, covariance = self._known.widening, found.covariance
        force, slopes = log_force(self._copy(found.state), local)
        towards, residual = self.layout.row(i, slopes), self._residual(found.state, i)
        x_sd, y_sd, depth_sd = np.sqrt(np.diag(covariance)[at : at + 3])
        depth = math.exp(local[2])
        return PressFound(
            float(local[0]),
            float(local[1]),
            depth,
            math.exp(force),
            wider.place * float(x_sd),
            wider.place * float(y_sd),
            wider.depth * float(depth_sd) * depth,
            wider.force * math.sqrt(towards @ covariance @ towards),
            math.sqrt(float(residual @ residual) / max(int(np.count_nonzero(residual)), 1)),
        )

    def _residual(self, state: State, i: int) -> Pixels:
        local = self.layout.own_of(state)[i]
        key = state[: len(TERMS)].tobytes() + local.tobytes()
        kept = self._left.setdefault(i, [])
        for at, left in kept:
            if at == key:
                return left
        seen = shown(self._copy(state), local, self._backdrop, kept=self._masks[i])
        left = self._pixels[i] - seen
        self._left[i] = [*kept[-1:], (key, left)]
        return left

    def _copy(self, state: State) -> PalmCopy:
        return replace(self._known, terms=state[: len(TERMS)])

    def _slopes(self, state: State, i: int) -> Float[ndarray, "n u"]:
        here = state[: len(TERMS)], self.layout.own_of(state)[i]
        if i not in self._slopes_at or not still_near(self._slopes_at[i][0], here):
            slopes = picture_slopes(self._copy(state), here[1], self._backdrop, self._masks[i])
            self._slopes_at[i] = here, slopes
        return self._slopes_at[i][1]


def joined(terms: Terms, local: Float[ndarray, "p 8"]) -> State:
    """Return the state of terms and press unknowns."""
    return np.concatenate([terms, local.ravel()])


ALLOWED = {"modulus": 0.05, "coefficient": 0.03}  # relative half width of a 90 % interval
COVERED = 1.645
FORCE_SHARE, PLACE_SD_M = 0.01, 30e-6  # accuracy of a further press
SHALLOW, DEEP = 0.2, 0.8  # depths of candidate presses over the maximum
AWAY = 0.5  # distance of candidate presses from the axis over the radius


class UnsureConstant(NamedTuple):
    """A constant with a wide interval.

    Attributes:
        constant: "modulus" or "coefficient".
        half_share: Half width of its 90 % interval, relative.
        fault: Term that it is most correlated with.
        owed: Fraction of its variance that would vanish if that term were known.
        x_m, y_m, depth_m, force_n: Most informative further press.
        then_share: Half width with that press, relative.
    """

    constant: str
    half_share: float
    fault: str
    owed: float
    x_m: float
    y_m: float
    depth_m: float
    force_n: float
    then_share: float


def unsure_constants(copy: PalmCopy, progress: Progress = silent) -> tuple[UnsureConstant, ...]:
    """Return the constants of E and C whose 90 % half interval exceeds 5 % and 3 %."""
    directions = {"modulus": _direction(1.0, 0.0), "coefficient": _direction(-1.0, 1.0)}
    half = {name: COVERED * _spread(copy.covariance, one) for name, one in directions.items()}
    wide = {name: one for name, one in directions.items() if half[name] > ALLOWED[name]}
    if not wide:
        return ()
    thought = _presses(copy)
    after = []
    for i, local in enumerate(thought):
        progress("thinking of presses", i, len(thought))
        after.append(told_by(copy, local))
    return tuple(_unsure(copy, name, one, thought, after) for name, one in wide.items())


def told_by(copy: PalmCopy, local: Float[ndarray, " 8"]) -> Float[ndarray, "t t"]:
    """Return the covariance of a unit's terms after one more press of known force and position."""
    n = len(TERMS)
    few = replace(copy, spec=replace(copy.spec, rays_per_pixel=(1, 1)))  # rays, which do for advice
    J = picture_slopes(few, local, None, away_from_edges(copy, local))
    _, slopes = log_force(copy, local)
    H = J.T @ J / (PIXEL_SD * BLOCK_PX) ** 2 + np.outer(slopes, slopes) / FORCE_SHARE**2
    own = [1 / PLACE_SD_M**2, 1 / PLACE_SD_M**2, 0.0, *(1 / one**2 for one in copy.local_spreads)]
    H[n:, n:] += np.diag(own)
    return covariance_with(copy.covariance, H)


def _unsure(
    copy: PalmCopy, name: str, towards: ndarray, thought: list[ndarray], after: list[ndarray]
) -> UnsureConstant:
    variance = _spread(copy.covariance, towards) ** 2
    owed = (copy.covariance @ towards) ** 2 / np.diag(copy.covariance) / variance
    fault = 2 + int(np.argmax(owed[2:]))
    spreads = [_spread(one, towards) for one in after]
    best = int(np.argmin(spreads))
    local = thought[best]
    force_n = math.exp(log_force(copy, local)[0])
    return UnsureConstant(
        name, COVERED * math.sqrt(variance), TERMS[fault], float(owed[fault]), float(local[0]),
        float(local[1]), math.exp(local[2]), force_n, COVERED * spreads[best],
    )  # fmt: skip


def _presses(copy: PalmCopy) -> list[ndarray]:
    """Candidate presses: shallow and deep, in the middle and away from it."""
    away, deepest = AWAY * copy.spec.radius_m, deepest_m(copy.spec)
    found = []
    for x, y in ((0.0, 0.0), (away, 0.0), (0.0, away)):
        for share in (SHALLOW, DEEP):
            local = np.zeros(len(LOCAL))
            local[:3] = x, y, math.log(max(share * deepest, MIN_DEPTH_M))
            found.append(local)
    return found


def _direction(modulus: float, product: float) -> Float[ndarray, " t"]:
    towards = np.zeros(len(TERMS))
    towards[:2] = modulus, product
    return towards


def _spread(covariance: ndarray, towards: ndarray) -> float:
    return math.sqrt(float(towards @ covariance @ towards))
