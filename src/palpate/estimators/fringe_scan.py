"""The search behind `fringe_order`: every slope is tried.

The misfit has a valley at every slope that turns the same brightnesses by some whole fringe more or less, so
no descent from one start finds the right one. On the grid the gain and the leak are in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from palpate.core.errors import InputError, RangeError
from palpate.core.shapes import Bool, Float
from palpate.estimators.fringe_light import Polariscope

UNKNOWNS = 4  # k, N0, a and b
LEAST_ORDER = 0.1  # at the greatest load; where the scan begins if the gain is not known
LEAST_WITH_GAIN = 0.02
STEP = 0.02  # of the scan, in orders at the greatest load
CANDIDATES = 5
HOPELESS = 20.0  # times the best one's misfit: likelihood below 1e-3 with five photographs to spare
TOO_LITTLE = (
    "the photographs show too small a part of a fringe to tell the order from the lamp's brightness; "
    "load more, or add a photograph between parallel polarisers"
)
TOO_MUCH = "the best fit lies at the scan's end, order {:g} at the greatest load; allow greater orders"


@dataclass(frozen=True, slots=True)
class Traces:
    """What is fitted: light over its range, one row a photograph and perhaps one for parallel polarisers."""

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
        clipped: ndarray,
        open_light: ndarray | None,
        polariscope: Polariscope,
        channels: tuple[int, ...],
        residual_order: float,
    ) -> Traces:
        use = list(channels)
        y, cut = light[..., use], clipped[..., use]
        scale = np.maximum(np.ptp(y, axis=0), 1e-3 * np.max(np.ptp(y, axis=0)))
        if open_light is not None:
            if not (np.isfinite(open_light).all() and (open_light[..., use] > 0).all()):
                raise InputError(
                    "the photograph between parallel polarisers is dark somewhere in the region; take it "
                    "with the specimen unloaded and the analyser turned by 90 degrees"
                )
            y = np.concatenate([y, open_light[None, :, use]])
            cut = np.concatenate([cut, np.zeros((1, *cut.shape[1:]), dtype=bool)])
        opened = open_light is not None
        return cls(load_n, y / scale, scale, cut, polariscope, channels, opened, residual_order)

    @property
    def least_order(self) -> float:
        """Order at the greatest load where the scan begins."""
        return LEAST_WITH_GAIN if self.open_row else LEAST_ORDER

    def model(self, order: ndarray) -> tuple[ndarray, ndarray]:
        """S of every row and its derivative by N ``[... rows c]``, at the photographs' orders."""
        s, by_order = (v[..., list(self.channels)] for v in self.polariscope.light_and_slope(order))
        if not self.open_row:
            return s, by_order
        row = np.ones((*s.shape[:-2], 1, s.shape[-1]))
        return np.concatenate([s, row], axis=-2), np.concatenate([by_order, 0 * row], axis=-2)


def candidates(traces: Traces, greatest_order: float) -> list[tuple[float, float]]:
    """Slopes and offsets of the scan's deepest valleys, best first."""
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
        raise RangeError(TOO_MUCH.format(greatest_order) if over else TOO_LITTLE)
    kept = [i for i in deepest[:CANDIDATES] if valley[i] <= HOPELESS * valley[deepest[0]]]
    return [(float(slopes[i]), float(offsets[cost[i].argmin()])) for i in kept]


def profiled(traces: Traces, slopes: ndarray, offset: float) -> ndarray:
    """Mean over patches of the squared misfit at each slope, gain and leak being the best not below 0."""
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
