"""Fringe order against load, from whole photographs of a specimen with a known stress field.

At load P, a point with s1 - s2 of u times the reference point's has in channel c the light

    v_c = b_c + a_c V S_c(u N),   N = k P + N0,

S as in `fringe_light`, V the visibility. Gain a and leak b of every photograph and channel are unknown. One
photograph holds several orders, so each identifies its own N and evenly spaced loads do not alias. N is
scanned with a and b in closed form; the line through the photographs' N gives k, their scatter the Student
interval.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import t as student

from palpate.core import Bool, Float, InputError, RangeError, ndarray
from palpate.estimators.fringe_light import Polariscope
from palpate.estimators.fringe_order import CONFIDENCE, OrderCandidate, OrderFit, check_loads

STEP = 0.02  # of the scan, in orders at the greatest u
MIN_ORDER = 0.02
TABLE_STEP = 2e-3  # orders; linear between leaves less than 2e-5 of the light
ENOUGH = 0.5  # orders at the greatest u from which a photograph identifies its own
LOAD_TOLERANCE = 0.15  # by which one load may be off the line when its valley is looked for
MIN_CONTRAST = 0.3  # least range of u over its maximum
HOPELESS = 0.7  # residual ratio of the light's variance from which the fit has failed
BANDS = 4  # of the region, fitted apart to see whether the field is the right one
NEAR = 0.25  # orders, about the line, for a photograph that identifies none
UNKNOWNS = 2  # k and N0
CANDIDATES = 5
ROUNDS = 8
TINY = 1e-12
ALIKE = "the field's fringes at the loads taken nearly fall together"


def fit_field(
    load_n: Float[ndarray, " n"],
    light: Float[ndarray, "n p c"],
    field: Float[ndarray, " p"],
    polariscope: Polariscope,
    *,
    visibility: Float[ndarray, " p"] | None = None,
    clipped: Bool[ndarray, "n p c"] | None = None,
    greatest_order: float = 6.0,
    residual_order: float = 0.05,
) -> OrderFit:
    """Fit orders per newton at the reference point to the light of a whole known field.

    Args:
        load_n: Load of each photograph, not negative [N].
        light: Linear light at the points, any scale.
        field: u, s1 - s2 of each point over that of the reference point.
        polariscope: Polariscope with as many channels as `light`.
        visibility: V, 0 to 1; sin^2 of twice the angle between axis and polarizer in a plane polariscope.
        clipped: Saturated light, which is omitted.
        greatest_order: Greatest N of the scan at the greatest load.
        residual_order: Prior standard deviation of N0.

    Returns:
        The fit; `rms` is relative to the light's standard deviation, `spread` of k between quarters of the
            region.
    """
    check_loads(load_n)
    _check(load_n, light, field)
    every = _Scan(
        light, clipped, field, np.ones(len(field)) if visibility is None else visibility, polariscope
    )
    orders = np.arange(MIN_ORDER, (1 + LOAD_TOLERANCE) * greatest_order, STEP / field.max())
    model = every.model(orders)
    cost = every.misfit(model)
    k, rivals = _joint(cost, orders, load_n, field.max(), greatest_order)
    own, told = _own_orders(cost, orders, k * load_n, field.max())
    k, n0, half, scatter = line_through(load_n[told], own[told], residual_order)
    if not half < k:
        raise RangeError(
            f"the photographs do not tell the orders per newton: {k:.3g} ± {half:.2g} 1/N reaches zero; load "
            "more, or check where the specimen lies in the photographs"
        )
    parts = np.array_split(np.arange(len(field)), BANDS)
    bands = [every.only(part).misfit(model[:, part]) for part in parts]
    apart = [_own_orders(band, orders, own, field.max())[0] for band in bands]
    slopes = [line_through(load_n[told], one[told], residual_order)[0] for one in apart]
    unexplained = [np.interp(m, orders, c) for m, c in zip(own[told], cost[told], strict=True)]
    gain, leak = every.gain_and_leak(own, told)
    return OrderFit(
        slope_per_n=k,
        half_width_per_n=half,
        residual_order=n0,
        order=k * load_n + n0,
        own_order=np.where(told, own, k * load_n + n0),
        own_low=np.where(told, own - scatter, n0 - NEAR + k * load_n),
        own_high=np.where(told, own + scatter, n0 + NEAR + k * load_n),
        channels=tuple(range(light.shape[2])),
        gain=gain,
        leak=leak,
        rms=float(np.sqrt(np.mean(unexplained))),
        spread=float(np.std(slopes) / k),
        rivals=rivals,
    )


class _Scan:
    """Light of a field at every order of a scan, compared with photographs."""

    def __init__(
        self,
        light: ndarray,
        clipped: ndarray | None,
        field: ndarray,
        visibility: ndarray,
        polariscope: Polariscope,
    ) -> None:
        self.light, self.field, self.visibility, self.polariscope = light, field, visibility, polariscope
        self.counts = np.ones(light.shape) if clipped is None else (~clipped).astype(float)

    def only(self, points: ndarray) -> _Scan:
        cut = self.counts[:, points] == 0
        return _Scan(
            self.light[:, points], cut, self.field[points], self.visibility[points], self.polariscope
        )

    def model(self, order: ndarray) -> ndarray:
        """V S of every order, point and channel ``[g p c]``."""
        at = np.multiply.outer(order, self.field)
        table = np.linspace(0.0, at.max(), 2 + int(at.max() / TABLE_STEP))
        light = self.polariscope.light(table)
        s = np.stack([np.interp(at, table, channel) for channel in light.T], axis=-1)
        return np.asarray(self.visibility[:, None] * s)

    def misfit(self, s: ndarray) -> ndarray:
        """Unexplained ratio of each photograph's variance under each model ``[n g]``."""
        left, total = np.zeros(1), np.zeros(1)
        for c in range(self.light.shape[2]):
            w, v, S = self.counts[..., c], self.light[..., c], s[..., c]
            n, y1, y2 = w.sum(axis=1), (w * v).sum(axis=1), (w * v**2).sum(axis=1)
            s1, s2, sy = w @ S.T, w @ (S**2).T, (w * v) @ S.T
            n, y1 = np.maximum(n, 1)[:, None], y1[:, None]
            shared = np.maximum(sy - s1 * y1 / n, 0)  # a gain below 0 is none
            variance = y2[:, None] - y1**2 / n
            left = left + variance - shared**2 / np.maximum(s2 - s1**2 / n, TINY)
            total = total + variance
        # Unlit photographs have no variance, and nothing of it is left over.
        return np.asarray(left / np.maximum(total, TINY))

    def gain_and_leak(self, own: ndarray, told: ndarray) -> tuple[ndarray, ndarray]:
        """Gain and leak of every channel, mean over the photographs that identify their order."""
        found = []
        for i in np.flatnonzero(told):
            s = self.model(own[i : i + 1])[0]
            for c in range(s.shape[-1]):
                use = self.counts[i, :, c] > 0
                A = np.stack([s[use, c], np.ones(use.sum())], axis=1)
                found.append(np.linalg.lstsq(A, self.light[i, use, c], rcond=None)[0])
        both = np.array(found).reshape(told.sum(), -1, 2).mean(axis=0)
        return both[:, 0], both[:, 1]


def line_through(
    load_n: Float[ndarray, " n"], own: Float[ndarray, " n"], residual_order: float
) -> tuple[float, float, float, float]:
    """Return k [1/N], N0, and half-widths of k [1/N] and of one photograph's order about the line."""
    quantile = float(student.ppf((1 + CONFIDENCE) / 2, max(len(own) - UNKNOWNS, 1)))
    X = np.stack([load_n, np.ones(len(own))], axis=1)
    noise = residual_order
    for _ in range(ROUNDS):
        known = X.T @ X / noise**2 + np.diag([0.0, residual_order**-2])
        k, n0 = np.linalg.solve(known, X.T @ own / noise**2)
        r = own - X @ (k, n0)
        noise = max(float(np.sqrt(r @ r / max(len(own) - UNKNOWNS, 1))), TINY)
    cov = np.linalg.inv(X.T @ X / noise**2 + np.diag([0.0, residual_order**-2]))
    # Errors alike in every photograph, or as large in each as its residual (loads do): the wider.
    L = cov[0] @ X.T / noise**2
    own_share = np.sum((L * r) ** 2) * len(own) / max(len(own) - UNKNOWNS, 1)
    prior = (cov[0, 1] / residual_order) ** 2
    half = quantile * float(np.sqrt(max(cov[0, 0], own_share + prior)))
    return float(k), float(n0), half, quantile * noise


def _joint(
    cost: ndarray, orders: ndarray, load_n: ndarray, top: float, greatest_order: float
) -> tuple[float, tuple[OrderCandidate, ...]]:
    """Slope at which all photographs together fit best within load tolerances, and rivals."""
    slopes = np.arange(ENOUGH / top, greatest_order, STEP / top) / load_n.max()
    joint = np.empty(len(slopes))
    for i, k in enumerate(slopes):
        own, told = _own_orders(cost, orders, k * load_n, top)
        seen = cost[np.arange(len(own)), np.searchsorted(orders, own).clip(max=len(orders) - 1)]
        joint[i] = np.where(told, seen, 1.0)[load_n > 0].mean()
    best = int(joint.argmin())
    if joint[best] > HOPELESS:
        raise RangeError(
            f"no order up to {greatest_order:g} explains the light (residual {joint[best]:.0%}); check "
            "--max-order",
            code="order-not-found",
        )
    own, told = _own_orders(cost, orders, slopes[best] * load_n, top)
    k = float(np.median(own[told] / load_n[told]))
    low = np.flatnonzero((joint[1:-1] < joint[:-2]) & (joint[1:-1] <= joint[2:])) + 1
    rivals = []
    for i in low[np.abs(slopes[low] / k - 1) > 2 * LOAD_TOLERANCE]:
        likelihood = (joint[best] / joint[i]) ** (max(len(load_n) - UNKNOWNS, 1) / 2)
        rivals.append(OrderCandidate(float(slopes[i]), float(likelihood), float(load_n.max()), ALIKE))
    return k, tuple(sorted(rivals, key=lambda one: -one.likelihood)[:CANDIDATES])


def _own_orders(cost: ndarray, orders: ndarray, near: ndarray, top: float) -> tuple[ndarray, ndarray]:
    """Order that fits each photograph best within its load tolerance, and whether it is identified."""
    own = near.astype(float).copy()
    told = near * top >= ENOUGH
    for i in np.flatnonzero(told):
        reach = LOAD_TOLERANCE * near[i]
        a, b = np.searchsorted(orders, (near[i] - reach, near[i] + reach))
        b = min(b + 1, len(orders))
        if b - a < 3:
            told[i] = False
            continue
        j = int(a) + int(cost[i, a:b].argmin())
        own[i] = orders[j] + _vertex(cost[i], j) * (orders[1] - orders[0])
    return own, told


def _vertex(y: ndarray, j: int) -> float:
    """Minimum of the parabola through three neighbors, in steps from the middle one."""
    if not 0 < j < len(y) - 1:
        return 0.0
    bend = y[j - 1] - 2 * y[j] + y[j + 1]
    return float(np.clip((y[j - 1] - y[j + 1]) / (2 * bend), -0.5, 0.5)) if bend > 0 else 0.0


def _check(load_n: ndarray, light: ndarray, field: ndarray) -> None:
    if light.shape[:2] != (len(load_n), len(field)):
        raise InputError(
            f"light of shape {light.shape} does not belong to {len(load_n)} loads and {len(field)} points"
        )
    if not (np.isfinite(light).all() and (light >= 0).all() and np.isfinite(field).all()):
        raise InputError("some light or field is negative or no number; leave out what is no specimen")
    if np.ptp(field) < MIN_CONTRAST * field.max():
        raise InputError(
            "the stress is nearly uniform over the region; use fit_orders", code="stress-uniform"
        )
