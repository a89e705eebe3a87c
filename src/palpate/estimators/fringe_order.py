"""Fringe order against load, from patches of photographs in a polariscope at several loads.

Each patch passes, in color channel c and at load P,

    v_c = b_c + a_c S_c(N),   S_c(N) = sum_k w_kc sin^2(pi N l0 C(l_k) / (l_k C(l0))),   N = k P + N0,

with unknown gain a and leak b. The misfit has a local minimum at every k that adds whole fringes, so all are
tried on a grid with a and b in closed form; the best are refined by soft-L1 least squares, patch by patch. Of
slopes that alias exactly the lowest is given and the others are named. The interval is Student's over
photographs, whose errors all patches share, plus the scatter of k between patches.

Reference for S: J. W. Dally and W. F. Riley, Experimental Stress Analysis, on the dark-field polariscope.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import t as student

from palpate.core import Bool, Float, InputError, RangeError, ndarray
from palpate.core.errors import ScanEdgeError
from palpate.estimators.fringe_light import Polariscope

MIN_PHOTOGRAPHS = 5  # one more than the unknowns k, N0, a and b
MIN_LOADS = 4
TIE = 0.5  # likelihood ratio to the best fit from which a slope ties with it

RIVAL = 0.05  # likelihood ratio to the best fit from which the fit is ambiguous
_DULL = 0.1  # relative change below which a channel is omitted
NO_NOISE = 1e-8  # least mean squared misfit
DECIDING_LOADS = 201
EVEN = 0.02  # of a step, by which evenly spaced loads may be off
WHOLE = 0.1  # of an order, by which two slopes that alias may be off a whole one
UNKNOWNS = 4  # k, N0, a and b
MIN_ORDER = 0.1  # at the greatest load; where the scan begins if the gain is not known
MIN_WITH_GAIN = 0.02
STEP = 0.02  # of the scan, in orders at the greatest load
CANDIDATES = 8
SCAN_ORDER = 24.0  # at the greatest load, where the scan ends if no greatest order is stated
HOPELESS = 20.0  # times the best one's misfit: likelihood below 1e-3 with five photographs to spare
TOO_LITTLE = (
    "the photographs show too small a part of a fringe to tell the order from the lamp's brightness; "
    "load more, or add a photograph between parallel polarisers"
)
TOO_MUCH = "the best fit is at the end of the scan, order {:g} at the greatest load; allow greater orders"


@dataclass(frozen=True, slots=True)
class Traces:
    """Light relative to its range, one row for each photograph and for parallel polarizers."""

    load_n: Float[ndarray, " n"]
    y: Float[ndarray, "rows p c"]
    scale: Float[ndarray, "p c"]
    clipped: Bool[ndarray, "rows p c"]
    polariscope: Polariscope
    channels: tuple[int, ...]
    open_row: bool
    residual_order: float

    @classmethod
    def of(
        cls,
        load_n: ndarray,
        light: ndarray,
        clipped: ndarray | None,
        open_light: ndarray | None,
        polariscope: Polariscope,
        residual_order: float,
    ) -> Traces:
        use = _lively(light)
        y = light[..., use]
        cut = np.zeros(y.shape, dtype=bool) if clipped is None else clipped[..., use]
        scale = np.maximum(np.ptp(y, axis=0), 1e-3 * np.max(np.ptp(y, axis=0)))
        if open_light is not None:
            if not (np.isfinite(open_light).all() and (open_light[..., use] > 0).all()):
                raise InputError(
                    "the photograph between parallel polarisers is dark in the region", code="white-image"
                )
            y = np.concatenate([y, open_light[None, :, use]])
            cut = np.concatenate([cut, np.zeros((1, *cut.shape[1:]), dtype=bool)])
        opened = open_light is not None
        return cls(load_n, y / scale, scale, cut, polariscope, tuple(use), opened, residual_order)

    @property
    def least_order(self) -> float:
        """Order at the greatest load at which the scan begins."""
        return MIN_WITH_GAIN if self.open_row else MIN_ORDER

    def model(self, order: ndarray) -> tuple[ndarray, ndarray]:
        """S of every row and its derivative by N ``[... rows c]``, at the photographs' orders."""
        s, by_order = (v[..., list(self.channels)] for v in self.polariscope.light_and_slope(order))
        if not self.open_row:
            return s, by_order
        row = np.ones((*s.shape[:-2], 1, s.shape[-1]))
        return np.concatenate([s, row], axis=-2), np.concatenate([by_order, 0 * row], axis=-2)


def candidates(traces: Traces, greatest_order: float) -> list[tuple[float, float]]:
    """Return slopes and offsets of the scan's deepest minima, best first."""
    top = traces.load_n.max()
    slopes = np.arange(traces.least_order, greatest_order + STEP / 2, STEP) / top
    offsets = traces.residual_order * np.linspace(-2, 2, 5)
    cost = np.stack([profiled(traces, slopes, offset) for offset in offsets], axis=1)
    noise = cost.min() / max(len(traces.y) - UNKNOWNS, 1)
    cost = cost + noise * (offsets / traces.residual_order) ** 2
    valley = cost.min(axis=1)
    inner = np.flatnonzero((valley[1:-1] < valley[:-2]) & (valley[1:-1] <= valley[2:])) + 1
    ends = [i for i, j in ((0, 1), (-1, -2)) if valley[i] < valley[j]]
    deepest = sorted([*inner, *ends], key=lambda i: valley[i])
    if not deepest or deepest[0] in ends:
        over = bool(deepest) and deepest[0] == -1
        raise ScanEdgeError(TOO_MUCH.format(greatest_order) if over else TOO_LITTLE)
    best = [i for i in deepest[:CANDIDATES] if valley[i] <= HOPELESS * valley[deepest[0]]]
    return [(float(slopes[i]), float(offsets[cost[i].argmin()])) for i in best]


def profiled(traces: Traces, slopes: ndarray, offset: float) -> ndarray:
    """Return the mean squared misfit over patches at each slope, with non-negative gain and leak."""
    s, _ = traces.model(slopes[:, None] * traces.load_n + offset)  # k, rows, c
    w = (~traces.clipped).astype(float)
    wy = w * traces.y
    n, y1, y2 = w.sum(axis=0), wy.sum(axis=0), (wy * traces.y).sum(axis=0)
    s1, s2 = np.einsum("knc,npc->kpc", s, w), np.einsum("knc,npc->kpc", s**2, w)
    sy = np.einsum("knc,npc->kpc", s, wy)
    tiny = 1e-12
    a = (n * sy - s1 * y1) / np.maximum(n * s2 - s1**2, tiny)
    b = (y1 - a * s1) / np.maximum(n, tiny)
    free = y2 - a * sy - b * y1
    no_leak = y2 - np.maximum(sy, 0) ** 2 / np.maximum(s2, tiny)
    flat = y2 - y1**2 / np.maximum(n, tiny)
    return np.asarray(np.where(a < 0, flat, np.where(b < 0, no_leak, free)).sum(axis=-1).mean(axis=-1))


CONFIDENCE = 0.95
EVALUATIONS = 60  # a candidate that has not settled by then lies in a flat valley and will not win
APART = 0.5  # how far a patch may go from the scan's slope, in orders at the greatest load: one mirror image
NEAR = 0.25  # how far from the line a photograph's own order is looked for; further lies its mirror image


@dataclass(frozen=True, slots=True)
class Fit:
    """Fit of every patch near one slope.

    Attributes:
        parameters: k [1/N], N0, a and b of each channel, one row for each patch.
        residuals: Model minus light, relative to each patch's range.
        influence: Derivative of each patch's k with respect to each datum [1/N].
        prior_share: Part of k's variance from the prior of N0 [1/N^2].
        whole: Every patch has a best k near the others'.
    """

    traces: Traces
    parameters: Float[ndarray, "p q"]
    residuals: Float[ndarray, "rows p c"]
    influence: Float[ndarray, "p m"]
    prior_share: float
    whole: bool

    @property
    def slopes(self) -> ndarray:
        return self.parameters[:, 0]

    @property
    def slope(self) -> float:
        return float(self.slopes.mean())

    @property
    def offset(self) -> float:
        return float(self.parameters[:, 1].mean())

    @property
    def cost(self) -> float:
        return float(np.mean(self.residuals**2))

    def freedom(self) -> int:
        """Photographs less unknowns."""
        return max(len(self.residuals) - UNKNOWNS, 1)

    def quantile(self) -> float:
        """Student's quantile of the interval."""
        return float(student.ppf((1 + CONFIDENCE) / 2, self.freedom()))

    def covariance(self) -> ndarray:
        """Covariance of one photograph's error between its channels ``[c c]``."""
        r = self.residuals.mean(axis=1)
        return np.asarray(r.T @ r / self.freedom())

    def half_width(self) -> float:
        """Half-width of k's interval [1/N]."""
        rows, patches, channels = self.residuals.shape
        L = self.influence.mean(axis=0).reshape(rows, channels)
        # Errors alike in every photograph, or as large in each as its residual: the wider of the two.
        even = np.einsum("nc,cd,nd->", L, self.covariance(), L)
        own = np.sum(np.sum(L * self.residuals.mean(axis=1), axis=1) ** 2) * rows / self.freedom()
        scatter = max(even, own)
        between = self.slopes.var(ddof=1) / patches if patches > 1 else 0.0
        return self.quantile() * float(np.sqrt(scatter + between + self.prior_share))

    def gain_and_leak(self) -> tuple[ndarray, ndarray]:
        """Gain and leak of every patch and channel ``[p c]``."""
        c = self.residuals.shape[2]
        return self.parameters[:, 2 : 2 + c], self.parameters[:, 2 + c :]

    def own_orders(self) -> tuple[ndarray, ndarray, ndarray]:
        """Return the order of each photograph by itself, and the range of orders it allows."""
        a, b = self.gain_and_leak()
        line = self.slope * self.traces.load_n + self.offset
        near = np.linspace(-NEAR, NEAR, 281)
        share = (self.slopes / self.slope)[:, None, None]
        order = (line + near[:, None]) * share  # p, near, n
        s = self.traces.polariscope.light(order)[..., list(self.traces.channels)]
        r = self.traces.y[: len(line)].transpose(1, 0, 2)[:, None] - b[:, None, None] - a[:, None, None] * s
        misfit = (r.mean(axis=0) ** 2).sum(axis=-1)  # near, n
        spare = self.quantile() ** 2 * np.trace(self.covariance())
        ends = np.array([_valley(column, spare) for column in misfit.T])
        best, low, high = near[ends].T
        return line + best, line + low, line + high


def _valley(misfit: ndarray, spare: float) -> tuple[int, int, int]:
    """Bottom of the valley that the middle lies in, and the ends of what is at most `spare` above it."""
    at = len(misfit) // 2
    step = 1 if misfit[at + 1] < misfit[at] else -1
    while 0 <= at + step < len(misfit) and misfit[at + step] < misfit[at]:
        at += step
    outside = np.flatnonzero(misfit > misfit[at] + spare)
    low = outside[outside < at].max(initial=-1) + 1
    high = outside[outside > at].min(initial=len(misfit)) - 1
    return at, int(low), int(high)


def refined(traces: Traces, starts: list[tuple[float, float]]) -> list[Fit]:
    """Return the refined candidates, best first, without duplicates and unidentifiable ones."""
    noise = np.sqrt(profiled(traces, np.array([starts[0][0]]), starts[0][1])[0])
    noise = max(float(noise) / np.sqrt(traces.y.shape[2] * max(len(traces.y) - UNKNOWNS, 1)), 1e-3)
    attempts = [_fit_near(traces, k, n0, noise) for k, n0 in starts]
    fits = sorted(attempts, key=lambda fit: (not fit.whole, fit.cost))
    apart = 2 * STEP / traces.load_n.max()
    distinct: list[Fit] = []
    for fit in fits:
        if all(abs(fit.slope - other.slope) > apart for other in distinct):
            distinct.append(fit)
    told = [fit for fit in distinct if fit.slope * traces.load_n.max() >= traces.least_order]
    if not told or told[0] is not distinct[0]:
        raise RangeError(TOO_LITTLE)
    return told


def _fit_near(traces: Traces, slope: float, offset: float, noise: float) -> Fit:
    patches = [_fit_patch(traces, p, slope, offset, noise) for p in range(traces.y.shape[1])]
    data = traces.y[:, 0].size
    influence = np.array([_influence(one) for one in patches]) / traces.load_n.max()
    residuals = np.stack([one.fun[:data].reshape(traces.y[:, 0].shape) for one in patches], axis=1)
    parameters = np.array([one.x for one in patches])
    parameters[:, 0] /= traces.load_n.max()
    prior = float((influence[:, data].mean() * noise) ** 2)
    whole = not any(one.active_mask[0] for one in patches)
    return Fit(traces, parameters, residuals, influence[:, :data], prior, whole)


def _fit_patch(traces: Traces, p: int, slope: float, offset: float, noise: float) -> OptimizeResult:
    """Fit of one patch: k (orders at the greatest load), N0, a, b; the last residual is N0's prior."""
    top, c = traces.load_n.max(), traces.y.shape[2]
    y, cut = traces.y[:, p], traces.clipped[:, p]

    share = np.append(traces.load_n / top, np.zeros(len(y) - len(traces.load_n)))[:, None, None]
    prior_row = np.zeros((1, 2 + 2 * c))
    prior_row[0, 1] = noise / traces.residual_order
    cache: dict[bytes, tuple[ndarray, ndarray]] = {}

    def both(x: ndarray) -> tuple[ndarray, ndarray]:
        """Residuals and their derivatives: at each point both are asked for."""
        s, by_order = traces.model(x[0] / top * traces.load_n + x[1])
        a, b = x[2 : 2 + c], x[2 + c :]
        r = a * s + b - y
        counts = ~(cut & (r > 0))  # saturated light is at least what is written
        by_line, each = (counts * a * by_order)[..., None], counts[..., None] * np.eye(c)
        J = np.concatenate([by_line * share, by_line, each * s[..., None], each], axis=-1)
        at = np.append((counts * r).ravel(), prior_row[0, 1] * x[1])
        cache.clear()
        cache[x.tobytes()] = at, np.concatenate([J.reshape(-1, 2 + 2 * c), prior_row])
        return cache[x.tobytes()]

    start = np.concatenate([[slope * top, offset], np.full(c, 1.0), np.maximum(y.min(axis=0), 1e-3)])
    low = np.concatenate([[max(start[0] - APART, 0.0), -np.inf], np.zeros(2 * c)])
    high = np.concatenate([[start[0] + APART], np.full(1 + 2 * c, np.inf)])
    return least_squares(
        lambda x: (cache.get(x.tobytes()) or both(x))[0],
        start,
        lambda x: (cache.get(x.tobytes()) or both(x))[1],
        bounds=(low, high),
        loss="soft_l1",
        f_scale=3 * noise,
        max_nfev=EVALUATIONS,
    )


def _influence(optimum: OptimizeResult) -> ndarray:
    """Derivative of k (orders at the greatest load) with respect to each residual."""
    free = optimum.active_mask == 0
    free[0] = True
    return np.asarray(-np.linalg.pinv(optimum.jac[:, free])[0])


Light = Float[ndarray, "n p c"]


@dataclass(frozen=True, slots=True)
class OrderCandidate:
    """Another slope that the photographs allow.

    Attributes:
        slope_per_n: k [1/N].
        likelihood: Likelihood relative to the slope given; up to 1 / TIE.
        deciding_load_n: Load at which the two slopes' lights differ most [N].
        why: Reason of the ambiguity, in words.
    """

    slope_per_n: float
    likelihood: float
    deciding_load_n: float
    why: str


@dataclass(frozen=True, slots=True)
class OrderFit:
    """Fringe orders of a series of photographs, and the line through them.

    Attributes:
        slope_per_n: k [1/N].
        half_width_per_n: Half-width of its 95 % interval [1/N].
        residual_order: N0.
        order: k P + N0 of each photograph.
        own_order, own_low, own_high: Order of each photograph by itself (within 0.25 of the line), 95 %
            interval.
        channels: Channels used.
        gain, leak: a and b of each channel, mean over patches; 0 and the mean light if not used.
        rms: RMS residual relative to each patch's range.
        spread: Relative standard deviation of k between patches.
        rivals: Other slopes, likeliest first; a likelihood above 0.05 makes the fit ambiguous.
    """

    slope_per_n: float
    half_width_per_n: float
    residual_order: float
    order: Float[ndarray, " n"]
    own_order: Float[ndarray, " n"]
    own_low: Float[ndarray, " n"]
    own_high: Float[ndarray, " n"]
    channels: tuple[int, ...]
    gain: Float[ndarray, " c"]
    leak: Float[ndarray, " c"]
    rms: float
    spread: float
    rivals: tuple[OrderCandidate, ...] = field(default=())

    @property
    def ambiguous(self) -> bool:
        """True if another slope fits nearly as well."""
        return any(rival.likelihood > RIVAL for rival in self.rivals)


def fit_orders(
    load_n: Float[ndarray, " n"],
    light: Light,
    polariscope: Polariscope,
    *,
    clipped: Bool[ndarray, "n p c"] | None = None,
    open_light: Float[ndarray, "p c"] | None = None,
    greatest_order: float = SCAN_ORDER,
    residual_order: float = 0.05,
) -> OrderFit:
    """Fit orders per newton to the light of some patches at several loads.

    Args:
        load_n: Load of each photograph, not negative [N].
        light: Linear light of each photograph, patch, and channel, any common scale, without exposure.
        polariscope: Polariscope with as many channels as `light`.
        clipped: Saturated light, which may be greater than stated.
        open_light: Light of the unloaded specimen between parallel polarizers, which fixes the gain; needed
            below about half an order.
        greatest_order: Greatest order at the greatest load; slopes beyond it are neither tried nor reported.
        residual_order: Prior standard deviation of N0.

    Returns:
        The fit; its interval does not hold the error of a wrong wavelength.
    """
    _check(load_n, light, polariscope, greatest_order, residual_order)
    traces = Traces.of(load_n, light, clipped, open_light, polariscope, residual_order)
    fits = refined(traces, candidates(traces, greatest_order))
    best = _lowest_of_ties(fits)
    half = best.half_width()
    if not half < best.slope:
        raise RangeError(
            f"the slope {best.slope:.3g} ± {half:.2g} 1/N reaches zero; take more photographs or load more"
        )
    others = [fit for fit in fits if fit is not best and fit.whole]
    rivals = [_rival(fit, best) for fit in others if abs(fit.slope - best.slope) > half]
    return _summary(light, traces, best, sorted(rivals, key=lambda rival: -rival.likelihood))


def _summary(light: Light, traces: Traces, best: Fit, rivals: list[OrderCandidate]) -> OrderFit:
    own, low, high = best.own_orders()
    used = list(traces.channels)
    gain, leak = np.zeros(light.shape[2]), light.mean(axis=(0, 1))
    gain[used], leak[used] = ((share * traces.scale).mean(axis=0) for share in best.gain_and_leak())
    return OrderFit(
        slope_per_n=best.slope,
        half_width_per_n=best.half_width(),
        residual_order=best.offset,
        order=best.slope * traces.load_n + best.offset,
        own_order=own,
        own_low=low,
        own_high=high,
        channels=traces.channels,
        gain=gain,
        leak=leak,
        rms=float(np.sqrt(best.cost)),
        spread=float(np.std(best.slopes) / best.slope),
        rivals=tuple(rivals),
    )


def check_loads(load_n: Float[ndarray, " n"]) -> None:
    """Refuse loads [N] that identify no slope."""
    if not (np.isfinite(load_n).all() and (load_n >= 0).all()):
        raise RangeError("a load is negative or no number; give loads of 0 N or more")
    photographs, loads = len(load_n), len(np.unique(load_n))
    if loads == 1:
        raise InputError(
            f"{photographs} photograph(s) at 1 load ({load_n[0]:.4g} N) do not identify C; take "
            f"{MIN_PHOTOGRAPHS} at {MIN_LOADS} or more different loads, unevenly spaced",
            code="too-few-loads",
        )
    if photographs < MIN_PHOTOGRAPHS or loads < MIN_LOADS:
        raise InputError(
            f"{photographs} photograph(s) at {loads} load(s); take {MIN_PHOTOGRAPHS} at {MIN_LOADS} "
            "different loads"
        )


def _likelihood(fit: Fit, other: Fit) -> float:
    """Likelihood ratio of two fits with unknown noise."""
    ratio = max(other.cost, NO_NOISE) / max(fit.cost, NO_NOISE)
    return float(ratio ** (fit.freedom() / 2))


def _lowest_of_ties(fits: list[Fit]) -> Fit:
    """Lowest slope of those that fit about as well as the best."""
    tied = [fit for fit in fits if fit is fits[0] or (fit.whole and _likelihood(fit, fits[0]) >= TIE)]
    return min(tied, key=lambda fit: fit.slope)


def _rival(fit: Fit, best: Fit) -> OrderCandidate:
    loads = best.traces.load_n
    load = np.linspace(0.0, loads.max(), DECIDING_LOADS)
    two = [best.traces.polariscope.light(one.slope * load + one.offset) for one in (best, fit)]
    used = list(best.traces.channels)
    decides = load[np.abs(two[0] - two[1])[:, used].sum(axis=1).argmax()]
    likelihood = min(_likelihood(fit, best), 1 / TIE)
    return OrderCandidate(fit.slope, likelihood, float(decides), _why_alike(best.slope, fit.slope, loads))


def _why_alike(one: float, other: float, load_n: ndarray) -> str:
    """Reason why two slopes give the same light at these loads."""
    step = np.diff(np.unique(load_n)).min()
    even = np.allclose(load_n / step, np.rint(load_n / step), atol=EVEN)
    for apart, words in ((other + one, "add up to"), (abs(other - one), "differ by")):
        whole = round(apart * step)
        if even and whole and abs(apart * step - whole) < WHOLE:
            orders = "a whole order" if whole == 1 else f"{whole} whole orders"
            return f"all loads are multiples of {step:.4g} N, at which the two slopes {words} {orders}"
    return "at the loads taken, the two slopes give nearly the same light"


def _lively(light: ndarray) -> list[int]:
    """Channels whose light changes with load."""
    change = np.ptp(light, axis=0).mean(axis=0)
    if not change.max() > 0:
        raise InputError(
            "the light in the region is the same at every load; move the region", code="light-constant"
        )
    return [int(c) for c in np.flatnonzero(change >= _DULL * change.max())]


def _check(
    load_n: ndarray, light: ndarray, polariscope: Polariscope, greatest_order: float, residual_order: float
) -> None:
    if len(load_n) != len(light) or light.shape[2] != polariscope.spectrum.weight.shape[1]:
        raise InputError(
            f"{len(load_n)} loads and light of shape {light.shape}, but "
            f"{polariscope.spectrum.weight.shape[1]} channels",
            code="shape",
        )
    check_loads(load_n)
    if not (np.isfinite(light).all() and (light >= 0).all()):
        raise InputError("light is negative or NaN; give linear light", code="light-range")
    if not (np.isfinite(greatest_order) and greatest_order > 2 * MIN_ORDER):
        raise RangeError(f"greatest order {greatest_order} is not above {2 * MIN_ORDER}; 6 is usual")
    if not 0.0 < residual_order <= 0.5:
        raise RangeError(f"residual order {residual_order} is outside 0 (excluded) to 0.5; 0.05 is usual")
