"""The best slopes of `fringe_scan`, refined patch by patch, and how well each is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import t as student

from palpate.core.errors import RangeError
from palpate.core.shapes import Float
from palpate.estimators.fringe_scan import STEP, TOO_LITTLE, UNKNOWNS, Traces, profiled

CONFIDENCE = 0.95
EVALUATIONS = 60  # a candidate that has not settled by then lies in a flat valley and will not win
APART = 0.5  # how far a patch may go from the scan's slope, in orders at the greatest load: one mirror image
NEAR = 0.25  # how far from the line a photograph's own order is looked for; further lies its mirror image


@dataclass(frozen=True, slots=True)
class Fit:
    """Every patch fitted near one slope.

    Attributes:
        parameters: k [1/N], N0, a of each channel and b of each channel, a row for each patch.
        residuals: model minus light, in shares of each patch's range.
        influence: how far each datum, were it 1 greater, would move its patch's k [1/N].
        prior_share: part of k's variance that comes from not knowing N0 [1/N^2].
        whole: every patch has a best k near the others', none wandered off to the end of where it may look.
    """

    traces: Traces
    parameters: Float[ndarray, "p q"]
    residuals: Float[ndarray, "rows p c"]
    influence: Float[ndarray, "p m"]
    prior_share: float
    whole: bool

    @property
    def slopes(self) -> ndarray:
        """Of every patch [1/N]."""
        return self.parameters[:, 0]

    @property
    def slope(self) -> float:
        """Mean over patches [1/N]."""
        return float(self.slopes.mean())

    @property
    def offset(self) -> float:
        """N0, mean over patches."""
        return float(self.parameters[:, 1].mean())

    @property
    def cost(self) -> float:
        """Mean squared residual."""
        return float(np.mean(self.residuals**2))

    def freedom(self) -> int:
        """Photographs beyond the unknowns."""
        return max(len(self.residuals) - UNKNOWNS, 1)

    def quantile(self) -> float:
        """Student's, for the interval's two ends."""
        return float(student.ppf((1 + CONFIDENCE) / 2, self.freedom()))

    def covariance(self) -> ndarray:
        """Of one photograph's error between its channels ``[c c]``."""
        r = self.residuals.mean(axis=1)
        return np.asarray(r.T @ r / self.freedom())

    def half_width(self) -> float:
        """Of k's interval [1/N]."""
        rows, patches, channels = self.residuals.shape
        L = self.influence.mean(axis=0).reshape(rows, channels)
        # Errors alike in every photograph, or as large in each as its residual: the wider of the two.
        even = np.einsum("nc,cd,nd->", L, self.covariance(), L)
        own = np.sum(np.sum(L * self.residuals.mean(axis=1), axis=1) ** 2) * rows / self.freedom()
        scatter = max(even, own)
        between = self.slopes.var(ddof=1) / patches if patches > 1 else 0.0
        return self.quantile() * float(np.sqrt(scatter + between + self.prior_share))

    def gain_and_leak(self) -> tuple[ndarray, ndarray]:
        """Both of every patch and channel ``[p c]``."""
        c = self.residuals.shape[2]
        return self.parameters[:, 2 : 2 + c], self.parameters[:, 2 + c :]

    def seen(self) -> tuple[ndarray, ndarray, ndarray]:
        """Order of each photograph by itself, and the orders it does not exclude."""
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
    """The candidates, each refined, best first; those that ran into one another are one."""
    noise = np.sqrt(profiled(traces, np.array([starts[0][0]]), starts[0][1])[0])
    noise = max(float(noise) / np.sqrt(traces.y.shape[2] * max(len(traces.y) - UNKNOWNS, 1)), 1e-3)
    found = [_fit_near(traces, k, n0, noise) for k, n0 in starts]
    fits = sorted(found, key=lambda fit: (not fit.whole, fit.cost))
    apart = 2 * STEP / traces.load_n.max()
    kept: list[Fit] = []
    for fit in fits:
        if all(abs(fit.slope - other.slope) > apart for other in kept):
            kept.append(fit)
    if kept[0].slope * traces.load_n.max() < traces.least_order:
        raise RangeError(TOO_LITTLE)
    return kept


def _fit_near(traces: Traces, slope: float, offset: float, noise: float) -> Fit:
    found = [_fit_patch(traces, p, slope, offset, noise) for p in range(traces.y.shape[1])]
    data = traces.y[:, 0].size
    influence = np.array([_influence(one) for one in found]) / traces.load_n.max()
    residuals = np.stack([one.fun[:data].reshape(traces.y[:, 0].shape) for one in found], axis=1)
    parameters = np.array([one.x for one in found])
    parameters[:, 0] /= traces.load_n.max()
    prior = float((influence[:, data].mean() * noise) ** 2)
    whole = not any(one.active_mask[0] for one in found)
    return Fit(traces, parameters, residuals, influence[:, :data], prior, whole)


def _fit_patch(traces: Traces, p: int, slope: float, offset: float, noise: float) -> OptimizeResult:
    """One patch: k (in orders at the greatest load), N0, a, b. The last residual is what is known of N0."""
    top, c = traces.load_n.max(), traces.y.shape[2]
    y, cut = traces.y[:, p], traces.clipped[:, p]

    share = np.append(traces.load_n / top, np.zeros(len(y) - len(traces.load_n)))[:, None, None]
    known = np.zeros((1, 2 + 2 * c))
    known[0, 1] = noise / traces.residual_order
    held: dict[bytes, tuple[ndarray, ndarray]] = {}

    def both(x: ndarray) -> tuple[ndarray, ndarray]:
        """Residuals and their derivatives: at each point both are asked for."""
        s, by_order = traces.model(x[0] / top * traces.load_n + x[1])
        a, b = x[2 : 2 + c], x[2 + c :]
        r = a * s + b - y
        counts = ~(cut & (r > 0))  # saturated light is at least what is written
        turned, each = (counts * a * by_order)[..., None], counts[..., None] * np.eye(c)
        J = np.concatenate([turned * share, turned, each * s[..., None], each], axis=-1)
        at = np.append((counts * r).ravel(), known[0, 1] * x[1])
        held.clear()
        held[x.tobytes()] = at, np.concatenate([J.reshape(-1, 2 + 2 * c), known])
        return held[x.tobytes()]

    start = np.concatenate([[slope * top, offset], np.full(c, 1.0), np.maximum(y.min(axis=0), 1e-3)])
    low = np.concatenate([[max(start[0] - APART, 0.0), -np.inf], np.zeros(2 * c)])
    high = np.concatenate([[start[0] + APART], np.full(1 + 2 * c, np.inf)])
    return least_squares(
        lambda x: (held.get(x.tobytes()) or both(x))[0],
        start,
        lambda x: (held.get(x.tobytes()) or both(x))[1],
        bounds=(low, high),
        loss="soft_l1",
        f_scale=3 * noise,
        max_nfev=EVALUATIONS,
    )


def _influence(found: OptimizeResult) -> ndarray:
    """How much each residual, were it 1, would move k (in orders at the greatest load)."""
    free = found.active_mask == 0
    free[0] = True
    return np.asarray(-np.linalg.pinv(found.jac[:, free])[0])
