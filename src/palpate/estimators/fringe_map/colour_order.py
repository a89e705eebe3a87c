"""Fringe order of every pixel from its color (RGB photoelasticity), with its uncertainty, frame by frame.

Each pixel is compared with a `ColourTable`. Every local minimum of the misfit is kept, and one is chosen by
misfit and by bounded continuity with its neighbors, so that errors do not spread along a path. The order is
interpolated by the misfit's parabola or mean; its standard deviation is the misfit's width. It needs a dark
field with circular polarizers; in a plane polariscope each pixel's visibility may be left free.

References: A. Ajovalasit, S. Barone and G. Petrucci, Towards RGB photoelasticity: full-field automated
photoelasticity in white light, Experimental Mechanics 35 (1995) 193; K. Ramesh,
T. Kasimayan and B. Neethi Simon, Digital photoelasticity - a comprehensive review, J. Strain Analysis 46
(2011) 245, doi:10.1177/0309324711401501.

Color of every fringe order: from spectra, or measured on a specimen of known orders.

A measured table needs one photograph of a beam in bending or of a disk in the same lamp, camera, and
exposure; light is gathered by order and smoothed by local parabolas.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.ndimage import uniform_filter

from palpate.core import Bool, Float, Float32, InputError, PathText, RangeError, UInt8, ndarray, new_file
from palpate.core.array_files import MAX_ARRAY_BYTES
from palpate.core.parsing import parser
from palpate.estimators.fringe_light import Polariscope
from palpate.estimators.fringe_map import colour_kernels as kernels
from palpate.estimators.fringe_map.order_map import (
    MAX_SIGMA,
    SATURATED,
    FrameNoise,
    OrderMap,
    Untold,
    measured_noise,
)
from palpate.mechanics.probe_contact import disc_difference
from palpate.optics.colour import Tone, linear_light
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


FLOOR = 3e-4  # standard deviation that the table's steps leave [orders]
MIN_ERROR = 0.001  # of light, which the table's steps leave
GIVE = 0.08  # standard deviation of the difference between neighbouring pixels [orders]
FOLLOW = 0.25  # and between two frames [orders]
UNLIKE = 12.5  # misfit over its freedom from which a colour is not in the table
SURE = 3.0  # natural log of the likelihood by which a choice leads
END = 2  # rows from the table's last within which more may be meant
MARGIN = 4.0  # standard deviations around the table that the index covers
SAMPLE = 4000  # pixels by which a frame is judged
COLOURED = 0.15  # order from which light has a colour
MIN_COLOURED = 0.01  # ratio of colored pixels needed to judge a frame
STRANGE = 5.0  # mean misfit over its freedom from which a frame's colours are not the table's
DIM = 0.1  # of the other channels' light over the table's: a channel without lamp
ALIKE = 0.005  # of light: channels that differ less in every pixel are one
SMOOTHED = 9  # pixels
NO_PIXEL = "no pixel is inside the mask; it is true (an image: not black) where the specimen is"


class ColourReader:
    """Read the fringe orders of the frames of one camera.

    Args:
        table: Colors of the orders.
        noise: Noise of the light; measured in the first frame by default.
        white: Linear light of the unloaded specimen between parallel polarizers, by pixel or channel (default
            1).
        leak: Linear light of each channel through crossed polarizers (default 0).
        mask: Pixels of the specimen.
        tone: Tone curve of 8-bit frames.
        isoclinics: The polariscope is plane, and each pixel's visibility is free.

    Example:
        >>> from palpate.estimators.fringe_light import white_led
        >>> from palpate.estimators.fringe_map import table_of
        >>> N = np.tile(np.linspace(0, 1.5, 60), (40, 1))
        >>> reader = ColourReader(table_of(white_led(), 3.0), noise=0.01)
        >>> found = reader.read(white_led().light(N))
        >>> bool(np.abs(found.order - N)[found.valid].max() < 0.02)
        True
    """

    def __init__(
        self,
        table: ColourTable,
        *,
        noise: FrameNoise | float | None = None,
        white: Float[ndarray, "*n 3"] | None = None,
        leak: Float[ndarray, " 3"] | None = None,
        mask: Bool[ndarray, "h w"] | None = None,
        tone: Tone = "srgb",
        isoclinics: bool = False,
    ) -> None:
        # Where visibility is free, pale colours of the guard would be as good as dim ones of low orders.
        self.table = table.unguarded() if isoclinics else table
        self.mask, self.tone, self.isoclinics = mask, tone, isoclinics
        self.noise = FrameNoise(noise) if isinstance(noise, int | float) else noise
        self._leak = np.zeros(3) if leak is None else leak
        self._white = np.ones(3) if white is None else white - self._leak
        if not (np.isfinite(self._white).all() and np.isfinite(self._leak).all() and (self._leak >= 0).all()):
            raise InputError(
                "light of the white image and leak must be finite numbers, the leak not negative"
            )
        self._gain = np.median(self._white.reshape(-1, 3), axis=0)
        if not (self._gain > 0).all() or not np.mean(self._white > 0.02) > 0.5:
            raise InputError(
                f"the white image has light of {self._gain.round(3).tolist()} in red, green and blue",
                code="white-image",
            )
        self._judged = False
        self._prepared: _Prepared | None = None
        self._codes: Float32[ndarray, "256 3"] | None = None  # once prepared

    def read(
        self, image: UInt8[ndarray, "h w *c"] | Float[ndarray, "h w *c"], before: OrderMap | None = None
    ) -> OrderMap:
        """Return the orders of a frame of 8-bit codes or linear light; `before` is the previous result."""
        self._check_shape(image, before)
        size = image.shape[:2]
        inside = np.ones(size, bool) if self.mask is None else self.mask
        if not inside.any():
            raise InputError(NO_PIXEL, code="mask-empty")
        if self._prepared is None:
            noise = self.noise or measured_noise(self._light(image) * self._gain)
            self._prepared = _Prepared(self.table, noise, self._gain)
        standard, saturated = self._standard(image)
        seen = inside & ~saturated
        if seen.sum() < inside.sum() / 2:
            raise InputError(
                f"{saturated[inside].mean():.0%} of the specimen is saturated; expose less", code="saturated"
            )
        if not self._judged:
            self._judged = self._judge(self._light(image)[seen])
        return self._map(standard.reshape(-1, 3), size, inside, saturated, before)

    def _standard(self, image: ndarray) -> tuple[Float32[ndarray, "h w 3"], Bool[ndarray, "h w"]]:
        """Light in standard deviations of its noise, and where it is saturated."""
        known = self._prepared
        assert known is not None
        if image.dtype != np.uint8:
            return known.standard(self._light(image)), np.zeros(image.shape[:2], bool)
        if self._white.ndim > 1:
            return known.standard(self._light(image)), np.asarray(image.max(axis=2) >= SATURATED)
        if self._codes is None:
            every = np.repeat(np.arange(256, dtype=np.uint8)[:, None, None], len(CHANNELS), axis=2)
            self._codes = known.standard(self._light(every))[:, 0]
        light, saturated = kernels.look_up(image, self._codes, SATURATED)
        return light, saturated

    def _map(
        self,
        flat: Float32[ndarray, "p 3"],
        size: tuple[int, int],
        inside: Bool[ndarray, "h w"],
        saturated: Bool[ndarray, "h w"],
        before: OrderMap | None,
    ) -> OrderMap:
        known = self._prepared
        assert known is not None
        if self.isoclinics:
            row, chi, count = kernels.by_scan(flat, known.table, True)
        else:
            row, chi, count = kernels.by_index(flat, known.table, known.index, known.low, known.size)
        weight = self._weight(size)
        old = np.full(size, -1, np.float32)
        if before is not None:
            np.copyto(old, before.order / STEP, where=before.valid)
        at, lead = kernels.choose(
            row,
            chi,
            count,
            (inside & ~saturated).ravel(),
            weight.ravel(),
            old.ravel(),
            np.float32(STEP**2 / (2 * GIVE**2)),
            np.float32(STEP**2 / (2 * FOLLOW**2)),
            size[1],
        )
        freedom = len(CHANNELS) - 1 - self.isoclinics
        order, sigma, misfit = (
            v.reshape(size)
            for v in kernels.read_off(
                flat, known.table, row, at, weight.ravel(), *known.fine, np.float32(freedom), self.isoclinics
            )
        )
        why = np.zeros(size, np.uint8)
        why[order > self.table.greatest_order - END * STEP] = Untold.BEYOND
        why[sigma > MAX_SIGMA] = Untold.FAINT
        why[lead.reshape(size) < SURE] = Untold.RIVAL
        why[misfit > UNLIKE] = Untold.UNLIKE
        why[saturated] = Untold.SATURATED
        why[~inside] = Untold.OUTSIDE
        return OrderMap(order, sigma, lead.reshape(size), misfit, why)

    def _light(self, image: ndarray) -> Float32[ndarray, "h w 3"]:
        """Light over the white image's, without the leak."""
        if image.dtype == np.uint8:
            codes = linear_light(np.arange(256.0), self.tone).astype(np.float32)
            light = codes[image]
        else:
            light = image.astype(np.float32)
        if self._leak.any():
            light = light - self._leak.astype(np.float32)
        if self._white.ndim == 1:
            return np.asarray(light / self._white.astype(np.float32))
        return np.asarray(light / np.maximum(self._white, 1e-3 * self._gain).astype(np.float32))

    def _weight(self, size: tuple[int, int]) -> Float32[ndarray, "h w"]:
        """Weight of a pixel's misfit; noise is relatively greater where the lamp is dim."""
        if self._white.ndim == 1:
            return np.ones(size, np.float32)
        share = np.clip(self._white / self._gain, 0.05, 2.0).mean(axis=2)
        return np.asarray(share**2, np.float32)

    def _check_shape(self, image: ndarray, before: OrderMap | None) -> None:
        if image.ndim != 3 or image.shape[2] != len(CHANNELS):
            raise InputError(
                f"a frame of shape {image.shape} is grey or no RGB image; give color frames",
                code="no-color-image",
            )
        if image.dtype != np.uint8 and not np.isfinite(image).all():
            raise InputError("the frame holds NaN or infinity", code="not-finite")
        others = {"mask": self.mask, "white image": self._white if self._white.ndim == 3 else None}
        others["frame before"] = None if before is None else before.order
        for name, other in others.items():
            if other is not None and other.shape[:2] != image.shape[:2]:
                raise InputError(
                    f"the frame is {image.shape[1]} × {image.shape[0]} px, the {name} {other.shape[1]} × "
                    f"{other.shape[0]}; use one size",
                    code="image-size",
                )

    def _judge(self, light: Float32[ndarray, "p 3"]) -> bool:
        """Refuse a frame whose colors are of another kind of light; False if too few to judge."""
        known = self._prepared
        assert known is not None
        some = light[:: max(len(light) // SAMPLE, 1)]
        bright = some[some.max(axis=1) > max(6 * known.dark, 0.02)]
        if len(bright) < MIN_COLOURED * len(some):
            return False
        if np.ptp(bright, axis=1).max() < ALIKE:
            raise InputError(
                "all three channels are the same: a grey image; give color frames",
                code="gray-image",
            )
        as_given, row = self._misfit(bright, (0, 1, 2))
        if as_given < STRANGE and not self.isoclinics:
            return bool((row * STEP > COLOURED).mean() > MIN_COLOURED)
        share = np.quantile(bright, 0.98, axis=0) / self.table.light.max(axis=0)
        if share.min() < DIM * share.max():
            dark = " and ".join(c for c, s in zip(CHANNELS, share, strict=True) if s < DIM * share.max())
            raise InputError(
                f"the frame has no light in {dark}; use a white lamp without a filter", code="one-color-only"
            )
        if self.isoclinics:
            return True
        swapped = {p: self._misfit(bright, p)[0] for p in list(permutations(range(3)))[1:]}
        best = min(swapped, key=lambda p: swapped[p])
        if swapped[best] < as_given / 2:
            names = ", ".join(CHANNELS[c] for c in best)
            raise InputError(
                f"the frame's channels are {names} (misfit {swapped[best]:.2g}, as given {as_given:.2g}); "
                "give red, green, blue",
                code="channel-order",
            )
        return True

    def _misfit(self, light: Float32[ndarray, "p 3"], order: tuple[int, ...]) -> tuple[float, ndarray]:
        known = self._prepared
        assert known is not None
        flat = known.standard(np.ascontiguousarray(light[:, order]))
        row, chi, count = kernels.by_index(flat, known.table, known.index, known.low, known.size)
        chi = np.where(np.arange(chi.shape[1]) < count[:, None], chi, np.inf)
        best = chi.argmin(axis=1)[:, None]
        least = np.minimum(np.take_along_axis(chi, best, 1)[:, 0] / 2, UNLIKE)
        return float(least.mean()), np.take_along_axis(row, best, 1)[:, 0]


class _Prepared:
    """Table on the scale of a camera's noise, and its index."""

    def __init__(self, table: ColourTable, noise: FrameNoise, gain: ndarray) -> None:
        self._noise = [
            FrameNoise(
                min(float(np.hypot(noise.read / g, max(table.error, MIN_ERROR))), 0.5),
                min(noise.shot / g, 0.9),
            )
            for g in gain
        ]
        self.dark = max(one.read for one in self._noise)
        self.table = np.ascontiguousarray(self.standard(table.light).T)
        self.low = self.table.min(axis=1) - np.float32(MARGIN)
        self.size = (self.table.max(axis=1) + np.float32(MARGIN) - self.low) / np.float32(kernels.SIDE)
        self.index = kernels.index_of(self.table, self.low, self.size)
        self.fine = np.float32(STEP), np.float32(FLOOR)

    def standard(self, light: Float[ndarray, "*n 3"]) -> Float32[ndarray, "*n 3"]:
        """Light in standard deviations of its noise."""
        return np.stack([n.standard(light[..., c]) for c, n in enumerate(self._noise)], -1).astype(np.float32)


def flat_field(light: Float[ndarray, "h w 3"]) -> Float[ndarray, "h w 3"]:
    """Return white light by pixel, smoothed over noise and scratches."""
    return np.asarray(uniform_filter(light, (SMOOTHED, SMOOTHED, 0), mode="nearest"))


def nearest_colour(light: Float[ndarray, "h w 3"], table: ColourTable) -> Float[ndarray, "h w"]:
    """Return the order of the nearest color, pixel by pixel (baseline)."""
    flat = light.reshape(-1, 3).astype(np.float32)
    row, chi, count = kernels.by_scan(
        flat, np.ascontiguousarray(table.unguarded().light.T.astype(np.float32)), False
    )
    chi = np.where(np.arange(chi.shape[1]) < count[:, None], chi, np.inf)
    found = np.take_along_axis(row, chi.argmin(axis=1)[:, None], 1)[:, 0]
    return np.asarray(STEP * found.reshape(light.shape[:2]))


def grey_order(light: Float[ndarray, "h w"]) -> Float[ndarray, "h w"]:
    """Return the inverse of sin^2(pi N) of one channel, 0 to 1/2 (baseline)."""
    return np.asarray(np.arcsin(np.sqrt(np.clip(light, 0.0, 1.0))) / np.pi)
