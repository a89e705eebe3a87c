"""Quality of a camera's picture from a few frames of a still scene: focus, noise, flicker, exposure, advice.

Focus is the blur of the sharpest edges, or a ratio to a reference frame. Flicker of lamps is brightness that
changes between frames, or moving bands with a rolling shutter; lamps synchronous with the frames are
invisible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
import numpy as np
from scipy.special import chdtri

from palpate.core import Float, Float32, ImageError, InputError, RangeError, Shaped, ndarray
from palpate.estimators.fringe_light import brightest_channel

MIN_FRAMES = 4
MIN_FLICKER_FRAMES = 12  # with fewer a frequency is not told
DARK, BRIGHT = 4, 251  # grey levels from which a pixel is taken to be at the end of the range
MAX_CLIPPED = 0.02  # share of pixels at the bright end
TOO_DARK, TOO_BRIGHT = 40.0, 210.0  # mean of the lit part [grey levels]
LIT = 0.25  # of the brightest hundredth's level: what is darker is no skin
SHARP_PX = 2.0  # blur of the sharpest edges, beyond which a picture is out of focus
MIN_SHARPNESS = 0.8  # of the reference's
MAX_NOISE = 4.0  # grey levels
MAX_FLICKER = 0.01  # of the brightness
FLICKER_NOISES = 4.0  # by which a frequency stands out of the others
STEP_PX = 0.7, 1.4  # blurs that are added, whose ratio of slopes tells the blur that is there
TIMES = 1, 2, 4  # of those blurs, until they are not small beside the one that is there
MAX_BLUR_PX = 8.0  # what varies over more is light, and no edge
WELL_TOLD = 1.2  # px: blur that is told well by the first
PIXEL_WIDTH = 1 / 12 + 1 / 3  # px²: of the pixel, and of the difference of the next but one
EDGE_QUANTILE = 0.998  # quantile of slopes that are the sharpest edges
MIN_SLOPE = 0.5  # grey levels a pixel
MIN_SLOPE_NOISES = 6.0  # of a slope, to be an edge
MAINS_HZ = 50.0, 60.0
SAME_HZ = 0.4  # of the frequencies that frames can tell apart: nearer ones are the same
BANDS = 32  # parts of a frame's rows in which flicker is looked for


@dataclass(frozen=True, slots=True)
class Flicker:
    """Brightness change over time.

    Attributes:
        amplitude: Half of peak to peak of the frame mean, relative to the level.
        frequency_hz: Apparent frequency, at most half the frame rate; None without a peak [Hz].
        bands: Amplitude of moving bands within a frame, relative to the level.
        mains_hz: Mains frequency (50 or 60) of lamps that explain it; None for none [Hz].
    """

    amplitude: float
    frequency_hz: float | None
    bands: float
    mains_hz: float | None


@dataclass(frozen=True, slots=True)
class ImageHealth:
    """Quality of the picture, from frames of a still scene.

    Attributes:
        blur_px: Standard deviation of the blur of the sharpest edges; None without an edge [px].
        sharpness: Fine contrast relative to the reference; None without one.
        noise: Temporal standard deviation of a pixel, frame brightness removed [gray levels].
        level: Mean of the lit part [gray levels].
        clipped: Fraction of pixels with a saturated channel.
        advice: Recommended actions, the most important first.
    """

    blur_px: float | None
    sharpness: float | None
    noise: float
    level: float
    clipped: float
    black: float
    flicker: Flicker
    advice: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether nothing is to be done."""
        return not self.advice

    def to_dict(self) -> dict[str, Any]:
        """The same as numbers and lists, for JSON."""
        return asdict(self)


def image_health(
    frames: Sequence[Shaped[ndarray, ...]],
    rate_hz: float,
    *,
    region: tuple[int, int, int, int] | None = None,
    reference: Shaped[ndarray, ...] | None = None,
) -> ImageHealth:
    """Measure whether a picture is fit for measurements.

    Args:
        frames: 8-bit gray ``[h w]`` or RGB ``[h w 3]`` frames of a still scene, in order.
        region: Region (x, y, width, height); the whole frame by default [px].
        reference: Earlier frame of the same scene for the comparison of focus.
    """
    stack = _stack(frames, region)
    if not (0 < rate_hz < math.inf):
        raise RangeError(
            f"frames at {rate_hz} Hz; give the rate at which they were taken, above 0 Hz", code="frame-rate"
        )
    grey = np.stack([_grey(one) for one in stack])
    mean = grey.mean(axis=0)
    noise = _noise(grey)
    sharpness = None
    if reference is not None:
        (apart,) = _stack([reference], region, least=1)
        if apart.shape != stack[0].shape:
            raise InputError(
                f"a reference of {list(apart.shape)} px and frames of {list(stack[0].shape)} px; give an "
                "earlier frame of the same camera"
            )
        sharpness = _sharpness(mean, _grey(apart), noise / math.sqrt(len(grey)), noise)
    brightest = np.stack([brightest_channel(one) for one in stack])
    found = ImageHealth(
        edge_blur_px(mean, noise / math.sqrt(len(grey))),
        sharpness,
        noise,
        _lit_level(mean),
        float((brightest >= BRIGHT).mean()),
        float((brightest <= DARK).mean()),
        flicker_of(grey, rate_hz),
        (),
    )
    return replace(found, advice=_advice(found))


def edge_blur_px(image: Float[ndarray, "h w"] | Float32[ndarray, "h w"], noise: float = 0.0) -> float | None:
    """Return the standard deviation of the blur of the sharpest edges, None without one below 8 px [px].

    An edge of height H blurred by s has the slope H / (s sqrt(2 pi)). The slope ratio after two further blurs
    gives s without H (Zhuo and Sim, doi:10.1016/j.patcog.2011.03.009).
    """
    blur = None
    for times in TIMES:
        a, b = (times * step for step in STEP_PX)
        small, large = _slopes(image, a), _slopes(image, b)
        limit = max(
            float(np.quantile(large, EDGE_QUANTILE)), MIN_SLOPE_NOISES * _slope_noise(noise, b), MIN_SLOPE
        )
        edges = large >= limit
        if not edges.any():
            return None
        squared = float(np.sum(small[edges] * large[edges]) / np.sum(large[edges] ** 2)) ** 2
        # The ratio squared is (s² + b²) / (s² + a²), and a pixel and a difference have widths of their own.
        wide = max(squared - 1.0, 1e-3)
        blur = math.sqrt(max((b**2 - squared * a**2) / wide - PIXEL_WIDTH, 0.0))
        if blur < WELL_TOLD * times:
            break
    return blur if blur is not None and blur < MAX_BLUR_PX else None


def flicker_of(grey: Float32[ndarray, "n h w"], rate_hz: float) -> Flicker:
    """Return the brightness change over time of whole frames and of bands of rows."""
    n, height, _ = grey.shape
    rows = min(BANDS, height)
    bands = grey[:, : height // rows * rows].reshape(n, rows, height // rows, -1).mean(axis=(2, 3))
    level = np.maximum(bands.mean(axis=0), 1.0)
    change = bands / level - 1
    over_all = change.mean(axis=1)
    within = change - over_all[:, None]
    frequency = _frequency(over_all, within, rate_hz) if n >= MIN_FLICKER_FRAMES else None
    amplitude = _sine_amplitude(over_all, frequency, rate_hz)
    banded = float(np.sqrt(np.mean([_sine_amplitude(b, frequency, rate_hz) ** 2 for b in within.T])))
    mains = None if frequency is None else _mains(frequency, rate_hz, n)
    return Flicker(amplitude, frequency, banded, mains)


def seen_frequency_hz(true_hz: float, rate_hz: float) -> float:
    """Frequency at which frames of a rate show another, folded into half of the rate [Hz]."""
    rest = true_hz % rate_hz
    return min(rest, rate_hz - rest)


def _frequency(over_all: Float[ndarray, " n"], within: Float[ndarray, "n b"], rate_hz: float) -> float | None:
    """The frequency that stands out; None where none does."""
    n = len(over_all)
    signals = np.concatenate([over_all[:, None] * math.sqrt(within.shape[1]), within], axis=1)
    window, padded = np.hanning(n)[:, None], 8 * n
    power = (np.abs(np.fft.rfft(_level(signals) * window, padded, axis=0)) ** 2).sum(axis=1)
    beside = np.concatenate([[np.inf], power, [0.0]])
    peaks = (power >= beside[:-2]) & (power >= beside[2:])
    peaks[:8] = False  # slower than one period in all of the frames: drift
    best = int(np.where(peaks, power, 0.0).argmax())
    usual = float(np.median(power[8:]))
    if power[best] < FLICKER_NOISES**2 * max(usual, 1e-15):
        return None
    return best * rate_hz / padded


def _sine_amplitude(change: Float[ndarray, " n"], frequency: float | None, rate_hz: float) -> float:
    """Amplitude of a sine of the frequency in a change, by least squares; of any change without one."""
    if frequency is None:
        return float(math.sqrt(2) * change.std())
    phase = 2 * np.pi * frequency / rate_hz * np.arange(len(change))
    basis = np.stack([np.cos(phase), np.sin(phase), np.ones(len(change))], axis=1)
    (a, b, _), *_ = np.linalg.lstsq(basis, change, rcond=None)
    return math.hypot(a, b)


def _mains(frequency: float, rate_hz: float, n: int) -> float | None:
    """Mains frequency whose lamps would show so: the nearer one, where it can be told."""
    apart = {mains: abs(seen_frequency_hz(2 * mains, rate_hz) - frequency) for mains in MAINS_HZ}
    near = min(apart, key=lambda mains: apart[mains])
    return near if apart[near] < max(SAME_HZ * rate_hz / n, 0.02 * 2 * near) else None


def _level(signals: Float[ndarray, "n b"]) -> Float[ndarray, "n b"]:
    """Signals less the straight line through each, by least squares."""
    line = np.vander(np.linspace(-1, 1, len(signals)), 2)
    return np.asarray(signals - line @ np.linalg.lstsq(line, signals, rcond=None)[0])


def _noise(grey: Float32[ndarray, "n h w"]) -> float:
    """Median standard deviation of a pixel over time, once the brightness of bands of rows is divided out."""
    level = np.maximum(grey.mean(axis=0), 1.0)
    bands = np.stack([cv2.blur((one / level).mean(axis=1), (1, 9)).ravel() for one in grey])
    even = grey / np.maximum(bands, 0.05)[:, :, None]
    freedom = len(grey) - 1  # the median of few frames' variances lies below their mean
    usual = float(np.median(even.var(axis=0, ddof=1))) * freedom / float(chdtri(freedom, 0.5))
    return math.sqrt(usual)


def _slopes(image: Float[ndarray, "h w"], sigma: float) -> Float32[ndarray, "_ _"]:
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma)
    gx = cv2.filter2D(smooth, cv2.CV_32F, np.array([[-0.5, 0, 0.5]], np.float32))
    gy = cv2.filter2D(smooth, cv2.CV_32F, np.array([[-0.5], [0], [0.5]], np.float32))
    slope = np.hypot(gx, gy)
    edge = math.ceil(3 * max(STEP_PX))
    return slope[edge:-edge, edge:-edge] if min(slope.shape) > 2 * edge + 4 else slope


def _slope_noise(noise: float, sigma: float) -> float:
    """Standard deviation of a slope of noise smoothed by a Gaussian, both directions together."""
    return noise / (2 * math.sqrt(math.pi) * sigma**2)


def _sharpness(
    now: Float32[ndarray, "h w"], then: Float32[ndarray, "h w"], noise_now: float, noise_then: float
) -> float:
    """Fine contrast of an image over an earlier one's, noise taken away from both."""
    square = []
    for image, noise in ((now, noise_now), (then, noise_then)):
        fine = cv2.GaussianBlur(image, (0, 0), 0.7) - cv2.GaussianBlur(image, (0, 0), 1.4)
        level = max(float(image.mean()), 1.0)
        # Share of white noise's variance that this difference of Gaussians lets through.
        left = 1 / (4 * math.pi * 0.7**2) + 1 / (4 * math.pi * 1.4**2) - 2 / (2 * math.pi * (0.7**2 + 1.4**2))
        square.append(max(float(np.mean(fine**2)) - left * noise**2, 0.0) / level**2)
    return math.sqrt(square[0] / square[1]) if square[1] > 0 else 1.0


def _lit_level(mean: Float32[ndarray, "h w"]) -> float:
    """Mean of what is lit; of all, where hardly anything is."""
    lit = mean > LIT * np.percentile(mean, 99)
    return float(mean[lit].mean()) if lit.any() else float(mean.mean())


def _grey(image: Shaped[ndarray, ...]) -> Float32[ndarray, "h w"]:
    return (image if image.ndim == 2 else image.mean(axis=2)).astype(np.float32)


def _stack(
    frames: Sequence[Shaped[ndarray, ...]], region: tuple[int, int, int, int] | None, least: int = MIN_FRAMES
) -> list[Shaped[ndarray, ...]]:
    """Frames cut to the region."""
    if len(frames) < least:
        raise InputError(
            f"{len(frames)} frames; {least} or more tell noise and flicker", code="too-few-frames"
        )
    first = frames[0]
    for image in frames:
        if image.dtype != np.uint8 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
            raise ImageError(
                f"a picture is judged by 8-bit grey or RGB frames, got {image.dtype} {list(image.shape)}"
            )
        if image.shape != first.shape:
            raise InputError(
                f"frames of {list(image.shape)} and {list(first.shape)} px; give those of one camera and size"
            )
    if region is None:
        return list(frames)
    x, y, width, height = region
    if x < 0 or y < 0 or min(width, height) < 16 or x + width > first.shape[1] or y + height > first.shape[0]:
        raise RangeError(
            f"a region {list(region)} px (x, y, width, height) in frames of {first.shape[1]} x "
            f"{first.shape[0]} px; it lies inside and is 16 px or more along each side"
        )
    return [image[y : y + height, x : x + width] for image in frames]


def _advice(found: ImageHealth) -> tuple[str, ...]:
    """What to do, what matters most first."""
    told = []
    if found.clipped > MAX_CLIPPED:
        told.append(
            f"{100 * found.clipped:.0f} % of the picture is saturated: shorten the exposure or dim the light"
        )
    if found.level < TOO_DARK:
        told.append(
            f"the lit part has {found.level:.0f} of 255 grey levels: more light or exposure, then gain"
        )
    elif found.level > TOO_BRIGHT and found.clipped <= MAX_CLIPPED:
        told.append(f"the lit part has {found.level:.0f} of 255 grey levels: shorten the exposure")
    flicker = found.flicker
    if flicker.frequency_hz is not None and max(flicker.amplitude, flicker.bands) > MAX_FLICKER:
        told.append(_flicker_advice(flicker))
    if found.sharpness is not None and found.sharpness < MIN_SHARPNESS:
        told.append(
            f"the picture is {100 * found.sharpness:.0f} % as sharp as the reference: refocus and lock the "
            "focus, or take the reference anew"
        )
    elif found.blur_px is not None and found.blur_px > SHARP_PX:
        told.append(
            f"the sharpest edges are blurred over {found.blur_px:.1f} px: focus on the skin, lock the focus"
        )
    if found.noise > MAX_NOISE:
        told.append(f"noise is {found.noise:.1f} grey levels: more light and less gain")
    return tuple(told)


def _flicker_advice(flicker: Flicker) -> str:
    size = f"{100 * max(flicker.amplitude, flicker.bands):.1f} %"
    if flicker.mains_hz is None:
        return (
            f"brightness changes by {size} at {flicker.frequency_hz:.1f} Hz: look at the light's supply, and "
            "lock exposure and gain"
        )
    period_ms = 1e3 / (2 * flicker.mains_hz)
    return (
        f"lamps on {flicker.mains_hz:.0f} Hz mains flicker by {size}, seen at {flicker.frequency_hz:.1f} Hz: "
        f"shade them off, or expose for a multiple of {period_ms:.4g} ms"
    )
