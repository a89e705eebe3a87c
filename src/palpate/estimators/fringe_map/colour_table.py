"""Color of every fringe order: from spectra, or measured on a specimen of known orders.

A measured table needs one photograph of a beam in bending or of a disk in the same lamp, camera, and
exposure; light is gathered by order and smoothed by local parabolas.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from palpate.core import Bool, Float, InputError, PathText, RangeError, ndarray, new_file
from palpate.core.array_files import MAX_ARRAY_BYTES
from palpate.core.parsing import parser
from palpate.estimators.fringe_light import Polariscope
from palpate.mechanics.disc_stress import disc_difference
from palpate.recordings import read_labels

STEP = 0.01  # orders between rows
MIN_ORDER, MAX_ORDER = 0.2, 20.0
GUARD = 150  # rows of a computed table past its greatest order
SPREAD = 0.025  # orders, standard deviation of the weights of a local parabola
MIN_BIN = 3  # pixels within one step of order
MAX_GAP = 3  # steps without them
MIN_CHANGE = 0.02  # of light 1: a channel that changes less shows no order
MAX_SHARE = 2.5  # times the centre's, up to which a disc's points are taken: its loads are no points
RIM = 0.95  # radii
CHANNELS = ("red", "green", "blue")


@dataclass(frozen=True, slots=True, eq=False)
class ColourTable:
    """Linear light of each channel at orders 0, 0.01, 0.02, ...

    Attributes:
        light: Light by order and channel, 1 at full scale.
        error: Standard deviation of an entry.
        guard: Rows at the end that only show what lies beyond.
    """

    light: Float[ndarray, "n 3"]
    source: str
    error: float = 0.0
    guard: int = 0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.light).all() and self.error >= 0):
            raise InputError(f"the table of {self.source} holds what is no number")
        if not MIN_ORDER <= self.greatest_order <= MAX_ORDER:
            raise RangeError(
                f"the table of {self.source} ends at order {self.greatest_order:g}, not {MIN_ORDER:g} to "
                f"{MAX_ORDER:g}"
            )
        flat = [c for c, v in zip(CHANNELS, np.ptp(self.light, axis=0), strict=True) if v < MIN_CHANGE]
        if flat:
            raise InputError(
                f"the table of {self.source} is constant in {' and '.join(flat)}", code="channel-constant"
            )
        if np.ptp(self.light - self.light.mean(axis=1, keepdims=True)) < MIN_CHANGE:
            raise InputError(
                f"the table of {self.source} is grey at all orders; use a white lamp", code="gray-table"
            )

    @property
    def order(self) -> Float[ndarray, " n"]:
        return STEP * np.arange(len(self.light))

    @property
    def greatest_order(self) -> float:
        """Order of the last row before the guard."""
        return STEP * (len(self.light) - 1 - self.guard)

    def unguarded(self) -> ColourTable:
        return self if not self.guard else replace(self, light=self.light[: -self.guard], guard=0)

    def write(self, path: Path) -> None:
        one = self.unguarded()
        columns = {"order": one.order.round(6), **dict(zip(CHANNELS, one.light.T.round(6), strict=True))}
        columns["error"] = np.full(len(one.light), round(self.error, 6))
        with new_file(path) as building:
            pd.DataFrame(columns).to_csv(building, index=False)


def table_of(polariscope: Polariscope, greatest_order: float = 4.0, error: float = 0.0) -> ColourTable:
    """Return the table of a lamp and camera of known spectra; 1 where all light passes."""
    if not MIN_ORDER <= greatest_order <= MAX_ORDER:
        raise RangeError(
            f"greatest order {greatest_order:g} is outside {MIN_ORDER:g} to {MAX_ORDER:g}", code="order-range"
        )
    light = polariscope.light(STEP * np.arange(round(greatest_order / STEP) + 1 + GUARD))
    return ColourTable(light, polariscope.lamp, error, GUARD)


def measured_table(
    light: Float[ndarray, "h w 3"], order: Float[ndarray, "h w"], source: str = "the calibration image"
) -> ColourTable:
    """Return the table of a frame of known orders, from order 0 to the first gap.

    Args:
        light: Linear light.
        order: N of each pixel, of any sign; NaN if unknown.
        source: Origin in words.
    """
    if light.shape[:2] != order.shape or not np.isfinite(light).all():
        raise InputError(
            f"light of {light.shape} and orders of {order.shape} must have one size and be finite",
            code="shape",
        )
    known = np.isfinite(order)
    N, v = np.abs(order[known]), light[known]
    bins = np.rint(N / STEP).astype(int)
    count = np.bincount(bins, minlength=1)
    rows = _unbroken(count)
    if rows < MIN_ORDER / STEP:
        raise InputError(
            f"{source} has too few pixels at orders 0 to {MIN_ORDER:g}; they begin at "
            f"{N.min() if N.size else float('nan'):.2f}",
            code="order-zero-missing",
        )
    at = STEP * np.arange(rows)
    table, error = np.empty((rows, 3)), np.zeros(rows)
    by_order = np.argsort(N, kind="stable")
    N, v = N[by_order], v[by_order]
    # Light is even in the order: what lies on the other side of 0 is known too.
    near = N < 3 * SPREAD
    N, v = np.concatenate([-N[near][::-1], N]), np.concatenate([v[near][::-1], v])
    for i, middle in enumerate(at):
        a, b = np.searchsorted(N, (middle - 3 * SPREAD, middle + 3 * SPREAD))
        table[i], error[i] = _parabola(N[a:b] - middle, v[a:b])
    return ColourTable(table, source, float(error.max()))


@parser("color table", InputError, max_bytes=MAX_ARRAY_BYTES)
def read_table(path: PathText) -> ColourTable:
    """Read a table from CSV with the columns order, red, green, blue, and optionally error."""
    table = read_labels(Path(path))
    missing = [c for c in ("order", *CHANNELS) if c not in table]
    if missing:
        raise InputError(f"{path} has no column {', '.join(missing)}", code="column-missing")
    values = table[["order", *CHANNELS]].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)
    order, light = values[:, 0], values[:, 1:]
    if not np.isfinite(values).all() or len(order) < 3 or not (np.diff(order) > 0).all():
        raise InputError(f"{path}: orders must be numbers that rise", code="order-sequence")
    if not 0 <= order[0] <= STEP or np.diff(order).max() > MAX_GAP * STEP + 1e-9:
        raise InputError(
            f"{path}: orders must begin at 0 and stand {MAX_GAP * STEP:g} apart at most", code="order-spacing"
        )
    if light.min() < -0.5 or light.max() > 4:
        raise InputError(
            f"{path} holds light up to {light.max():g}; linear light is 1 where a camera is full"
        )
    at = STEP * np.arange(int(order[-1] / STEP + 1e-6) + 1)
    error = pd.to_numeric(table["error"], errors="coerce").max() if "error" in table else 0.0
    return ColourTable(np.stack([np.interp(at, order, c) for c in light.T], axis=1), str(path), float(error))


def line_orders(
    shape: tuple[int, int],
    line_px: tuple[float, float, float, float],
    orders: tuple[float, float],
    width_px: float,
) -> Float[ndarray, "h w"]:
    """Return the orders of a strip on which they change evenly, as across a beam in pure bending.

    Args:
        shape: Height and width of the image [px].
        line_px: x and y of both ends [px].
        orders: Orders at both ends, of opposite sign around a neutral line.
        width_px: Width of the strip [px].
    """
    x0, y0, x1, y1 = line_px
    length = float(np.hypot(x1 - x0, y1 - y0))
    h, w = shape
    if length < 1 or not all(0 <= x < w and 0 <= y < h for x, y in ((x0, y0), (x1, y1))):
        raise InputError(f"line {line_px} px must have a length and lie in the image of {w} × {h} px")
    if orders[0] == orders[1] or not np.isfinite(orders).all() or not width_px > 0:
        raise InputError(f"orders {orders} at the ends must differ; width {width_px} px", code="order-ends")
    y, x = np.mgrid[0:h, 0:w]
    along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length**2
    across = np.abs((x - x0) * (y1 - y0) - (y - y0) * (x1 - x0)) / length
    N = orders[0] + (orders[1] - orders[0]) * along
    return np.where((along >= 0) & (along <= 1) & (across <= width_px / 2), N, np.nan)


def disc_orders(
    shape: tuple[int, int], disc_px: tuple[float, float, float], at_centre: float
) -> Float[ndarray, "h w"]:
    """Return the orders of a diametrically compressed disk by the closed form of its stress.

    Args:
        shape: Height and width of the image [px].
        disc_px: x and y of its center, and its diameter [px].
        at_centre: N at the center, 8 C P / (pi D lambda).
    """
    x0, y0, diameter = disc_px
    h, w = shape
    R = diameter / 2
    if not (R > 0 and R - 1 <= x0 <= w - R and R - 1 <= y0 <= h - R):
        raise InputError(f"disc {disc_px} px must lie within {w} × {h} px", code="disc-outside-image")
    if not at_centre > 0:
        raise InputError(f"order {at_centre} at the disc's centre must be above 0")
    y, x = np.mgrid[0:h, 0:w]
    u, v = (x - x0) / R, (y - y0) / R
    share, _ = disc_difference(u, v)
    return np.where((np.hypot(u, v) < RIM) & (share < MAX_SHARE), at_centre * share, np.nan)


def _unbroken(count: Float[ndarray, " n"] | ndarray) -> int:
    """Rows from 0 up to the first gap."""
    full: Bool[ndarray, " n"] = count >= MIN_BIN
    gap = 0
    for i, there in enumerate(full):
        gap = 0 if there else gap + 1
        if gap > MAX_GAP:
            return i - gap + 1
    return len(full) - gap


def _parabola(x: Float[ndarray, " m"], v: Float[ndarray, "m 3"]) -> tuple[ndarray, float]:
    """Value at 0 of the parabola through weighted points, and its greatest standard error."""
    weight = np.exp(-(x**2) / (2 * SPREAD**2))
    A = np.stack([np.ones(len(x)), x, x**2 / SPREAD], axis=1)
    normal = A.T @ (weight[:, None] * A)
    reach = np.linalg.solve(normal, (weight[:, None] * A).T)[0]
    value = reach @ v
    left = v - A @ np.linalg.lstsq(np.sqrt(weight)[:, None] * A, np.sqrt(weight)[:, None] * v, rcond=None)[0]
    spread = np.sqrt((weight[:, None] * left**2).sum(axis=0) / weight.sum())
    return value, float(spread.max() * np.sqrt((reach**2).sum()))
