"""Fringe order of every pixel from its color (RGB photoelasticity), with its uncertainty, frame by frame.

Each pixel is compared with a `ColourTable`. Every local minimum of the misfit is kept, and one is chosen by
misfit and by bounded continuity with its neighbors, so that errors do not spread along a path. The order is
interpolated by the misfit's parabola or mean; its standard deviation is the misfit's width. It needs a dark
field with circular polarizers; in a plane polariscope each pixel's visibility may be left free.

References: A. Ajovalasit, S. Barone and G. Petrucci, Towards RGB photoelasticity: full-field automated
photoelasticity in white light, Experimental Mechanics 35 (1995) 193; K. Ramesh,
T. Kasimayan and B. Neethi Simon, Digital photoelasticity - a comprehensive review, J. Strain Analysis 46
(2011) 245, doi:10.1177/0309324711401501.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np
from scipy.ndimage import uniform_filter

from palpate.core import Bool, Float, Float32, InputError, UInt8, ndarray
from palpate.estimators.fringe_map import colour_kernels as kernels
from palpate.estimators.fringe_map.colour_table import CHANNELS, STEP, ColourTable
from palpate.estimators.fringe_map.frame_noise import FrameNoise, measured_noise
from palpate.estimators.fringe_map.order_map import MAX_SIGMA, SATURATED, OrderMap, Untold
from palpate.optics.colour import Tone, linear_light

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
        return OrderMap(order, sigma, lead.reshape(size), np.full(size, np.nan, np.float32), misfit, why)

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
                f"a frame of shape {image.shape} is grey or no RGB image; give color or phase-stepped frames",
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
                "all three channels are the same: a grey image; give color or phase-stepped frames",
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


def order_from_colour(
    image: UInt8[ndarray, "h w *c"] | Float[ndarray, "h w *c"],
    table: ColourTable,
    *,
    noise: FrameNoise | float | None = None,
    white: Float[ndarray, "*n 3"] | None = None,
    leak: Float[ndarray, " 3"] | None = None,
    mask: Bool[ndarray, "h w"] | None = None,
    tone: Tone = "srgb",
    isoclinics: bool = False,
) -> OrderMap:
    """Return the fringe order of every pixel of one color frame; see `ColourReader`."""
    reader = ColourReader(
        table, noise=noise, white=white, leak=leak, mask=mask, tone=tone, isoclinics=isoclinics
    )
    return reader.read(image)


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
