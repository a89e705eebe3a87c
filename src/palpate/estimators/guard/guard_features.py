"""Features of an image for focus, geometry, and light.

Band powers and edges from pixel differences, gray levels, rows and columns, markers, and registration of a
thumbnail on the mean one by gradients for shift, turn, and zoom (Lucas and Kanade, IJCAI 1981, p. 674).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from palpate.core import Float, Float32, UInt8

OCTAVES = 4
MAX_MARKER_SIDE_PX = 240  # longer side of the image that markers are found in
MAX_COUNTED_PIXELS = 2**17  # for grey levels; of larger images every second row or fewer are counted
LOCAL_FEATURES = 8  # number of features of the residual thumbnail, the last ones
FLOOR = 0.02  # gray levels added before logarithms

Grey = UInt8[np.ndarray, "h w"]
Octave = UInt8[np.ndarray, "_ _"]


def image_features(prepared: UInt8[np.ndarray, "_ _ c"]) -> Float[np.ndarray, " k"]:
    """Return features of a prepared image; their number depends on the channels only."""
    grey = prepared[..., 0] if prepared.shape[2] == 1 else cv2.cvtColor(prepared, cv2.COLOR_RGB2GRAY)
    octaves = _octaves(grey)
    markers = _markers(next((each for each in octaves if max(each.shape) <= MAX_MARKER_SIDE_PX), octaves[-1]))
    parts = (*_bands(octaves), *_levels(grey), *_profiles(grey), *markers, *_tints(prepared))
    return np.array(parts, dtype=np.float64)


def _log(value: float) -> float:
    return math.log(value + FLOOR)


def _octaves(grey: Grey) -> list[Octave]:
    """Image pyramid by halves."""
    octaves = [grey]
    for _ in range(OCTAVES - 1):
        height, width = (max(1, side // 2) for side in octaves[-1].shape)
        octaves.append(cv2.resize(octaves[-1], (width, height), interpolation=cv2.INTER_AREA))
    return octaves


def _bands(octaves: list[Octave]) -> list[float]:
    """Log mean and log RMS of differences along rows, columns, and both diagonals."""
    found = []
    for one, other in (pair for grey in octaves for pair in _pairs(grey)):
        found.append(_log(cv2.norm(one, other, cv2.NORM_L1) / one.size))
        found.append(_log(math.sqrt(cv2.norm(one, other, cv2.NORM_L2SQR) / one.size)))
    return found


def _pairs(grey: Octave) -> tuple[tuple[Octave, Octave], ...]:
    if min(grey.shape) < 2:
        return ((grey, grey),) * 4
    return (
        (grey[:, 1:], grey[:, :-1]),
        (grey[1:], grey[:-1]),
        (grey[1:, 1:], grey[:-1, :-1]),
        (grey[1:, :-1], grey[:-1, 1:]),
    )


GREYS = np.arange(256)
SHARES = np.array([0.05, 0.5, 0.95])


def _levels(grey: Grey) -> list[float]:
    """Mean, spread, quantiles, and ratios at both ends and between dark and bright."""
    grey = grey[:: math.ceil(grey.size / MAX_COUNTED_PIXELS)]
    counts = cv2.calcHist([grey], [0], None, [256], [0, 256]).ravel().astype(np.float64) / grey.size
    mean = float(counts @ GREYS)
    spread = math.sqrt(counts @ (GREYS - mean) ** 2)
    upto = counts.cumsum()
    low, median, high = upto.searchsorted(SHARES).tolist()
    quarter = 0.25 * (high - low)
    first, end = math.floor(low + quarter) + 1, math.ceil(high - quarter)
    between = float(counts[first : max(first, end)].sum())
    ends = [math.log(share + 1e-4) for share in (float(counts[0]), float(counts[255]), between)]
    return [_log(mean), _log(spread), (low + 1) / 256, (median + 1) / 256, (high + 1) / 256, *ends]


def _profiles(grey: Grey) -> list[float]:
    """Centroid of the column and row means, and their greatest and mean second difference."""
    found = []
    for axis in (0, 1):
        means = cv2.reduce(grey, axis, cv2.REDUCE_AVG, dtype=cv2.CV_32F).ravel()
        found.append(float(means @ _along(len(means))) / max(float(means.sum()), FLOOR))
        steps = means[1:] - means[:-1]
        kinks = np.abs(steps[1:] - steps[:-1]) if len(means) > 2 else np.zeros(1)
        found += [_log(float(kinks.max())), _log(float(kinks.mean()))]
    return found


@lru_cache(maxsize=16)
def _along(count: int) -> Float[np.ndarray, " k"]:
    return np.linspace(-1, 1, count)


MIN_MARKER_PX = 3


def _markers(grey: Octave) -> list[float]:
    """Number, size, spread, and positions of bright markers, and number of specks."""
    level, brighter = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    _, _, boxes, middles = cv2.connectedComponentsWithStatsWithAlgorithm(
        brighter, 8, cv2.CV_32S, cv2.CCL_BBDT
    )
    size = boxes[1:, cv2.CC_STAT_AREA]
    large = size >= MIN_MARKER_PX
    count = int(np.count_nonzero(large))
    specks = math.log1p(len(size) - count)
    if not count:
        return [level / 256, specks, *(0.0,) * 7]
    logs = np.sort(np.log(size[large]))
    usual = (logs[(count - 1) // 2] + logs[count // 2]) / 2
    spread = math.sqrt(np.sum((logs - logs.sum() / count) ** 2) / count)
    height, width = grey.shape
    x, y = ((middles[1:][large] - ((width - 1) / 2, (height - 1) / 2)) / max(grey.shape)).T
    about = math.sqrt((x @ x + y @ y) / (2 * count))
    places = (float(x.sum()) / count, float(y.sum()) / count, about, float(x @ y) / count)
    return [level / 256, specks, math.log(count), float(usual), spread, *places]


def _tints(prepared: UInt8[np.ndarray, "_ _ c"]) -> list[float]:
    """Log red and blue over green; nothing for a gray image."""
    if prepared.shape[2] == 1:
        return []
    red, green, blue, _ = (mean + 1 for mean in cv2.mean(prepared))
    return [math.log(red / green), math.log(blue / green)]


@dataclass(frozen=True)
class Registration:
    """Weighted least-squares fit of a thumbnail to the calibration's mean one.

    Attributes:
        jacobian: Change of each pixel with shift along x and y, turn, zoom, gain, offset, and blur.
        inverse: Map from differences to those seven numbers.
    """

    mean: Float32[np.ndarray, " p"]
    jacobian: Float32[np.ndarray, "p 7"]
    inverse: Float32[np.ndarray, "7 p"]
    weight: Float32[np.ndarray, " p"]

    @classmethod
    def fit(cls, thumbs: Float32[np.ndarray, "n h w c"]) -> Registration:
        grey = thumbs.mean(axis=3, dtype=np.float64)
        mean, variance = grey.mean(axis=0), grey.var(axis=0)
        jacobian = _jacobian(mean)
        # A twentieth of the usual variance is rounding and noise, which no pixel is without.
        weight = 1 / (variance.ravel() + 0.05 * variance.mean() + 0.25)
        weighted = jacobian * weight[:, None]
        normal = jacobian.T @ weighted
        normal += np.diag(1e-6 * np.diag(normal) + 1e-9)
        inverse = np.linalg.solve(normal, weighted.T)
        return cls(*(part.astype(np.float32) for part in (mean.ravel(), jacobian, inverse, weight)))

    def features(self, thumb: Float32[np.ndarray, "h w c"]) -> Float[np.ndarray, " 8"]:
        """Return the seven numbers [px of the thumbnail, rad, ratios, gray levels] and log residual."""
        return self._fitted(thumb.mean(axis=2).ravel() - self.mean)

    def local_features(self, unlike: Float32[np.ndarray, "h w c"]) -> Float[np.ndarray, " 8"]:
        """Return the same of a thumbnail less its reconstruction, turn and zoom in px at the rim."""
        found, side = self._fitted(unlike.mean(axis=2).ravel()), max(unlike.shape[:2])
        found[2:4] *= side / 2
        return found

    def _fitted(self, difference: Float32[np.ndarray, " p"]) -> Float[np.ndarray, " 8"]:
        found = self.inverse @ difference
        left = difference - self.jacobian @ found
        return np.append(found, _log(math.sqrt(self.weight @ left**2 / len(left)))).astype(np.float64)


def _jacobian(mean: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "p 7"]:
    """Derivative of an image by shift along x and y [px], turn [rad], zoom, gain, offset, and blur."""
    padded = np.pad(mean, 1, mode="edge")
    along_x, along_y = (padded[1:-1, 2:] - padded[1:-1, :-2]) / 2, (padded[2:, 1:-1] - padded[:-2, 1:-1]) / 2
    sharper = 4 * mean - padded[1:-1, 2:] - padded[1:-1, :-2] - padded[2:, 1:-1] - padded[:-2, 1:-1]
    y, x = (i - (size - 1) / 2 for i, size in zip(np.indices(mean.shape), mean.shape, strict=True))
    turn, zoom = y * along_x - x * along_y, -(x * along_x + y * along_y)
    parts = (-along_x, -along_y, turn, zoom, mean, np.ones_like(mean), -sharper)
    return np.stack(parts, axis=-1).reshape(-1, 7)


def frame_features(
    prepared: UInt8[np.ndarray, "_ _ c"],
    thumb: Float32[np.ndarray, "h w c"],
    registration: Registration,
    unlike: Float32[np.ndarray, "h w c"] | None = None,
) -> Float[np.ndarray, " k"]:
    """Return all features of a prepared image.

    Args:
        prepared: Image.
        thumb: Its thumbnail.
        registration: Registration on the mean thumbnail.
        unlike: Thumbnail less its reconstruction; None without local features.
    """
    parts = [image_features(prepared), registration.features(thumb)]
    return np.concatenate(parts if unlike is None else [*parts, registration.local_features(unlike)])
