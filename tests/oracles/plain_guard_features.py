"""Features of an image for the guard, one after another as `guard_features` says them, without haste."""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from palpate.core import Float, ndarray

FLOOR = 0.02
MIN_MARKER_PX = 3


def features(prepared: ndarray) -> Float[ndarray, " k"]:
    """What `image_features` gives of a prepared image ``[h w c]``."""
    grey = prepared[..., 0] if prepared.shape[2] == 1 else cv2.cvtColor(prepared, cv2.COLOR_RGB2GRAY)
    octaves = [grey]
    for _ in range(3):
        height, width = (max(1, side // 2) for side in octaves[-1].shape)
        octaves.append(cv2.resize(octaves[-1], (width, height), interpolation=cv2.INTER_AREA))
    small = [each for each in octaves if max(each.shape) <= 240]
    parts = [
        *(number for each in octaves for number in _bands(each.astype(float))),
        *_levels(grey),
        *_profile(cv2.reduce(grey, 0, cv2.REDUCE_AVG, dtype=cv2.CV_32F).ravel()),
        *_profile(cv2.reduce(grey, 1, cv2.REDUCE_AVG, dtype=cv2.CV_32F).ravel()),
        *_markers(small[0] if small else octaves[-1]),
    ]
    if prepared.shape[2] == 3:
        red, green, blue = prepared.reshape(-1, 3).astype(float).mean(axis=0) + 1
        parts += [np.log(red / green), np.log(blue / green)]
    return np.array(parts, float)


def _log(value: float) -> float:
    return float(np.log(value + FLOOR))


def _bands(grey: ndarray) -> list[float]:
    if min(grey.shape) < 2:
        return [_log(0.0)] * 8
    along = grey[:, 1:] - grey[:, :-1], grey[1:] - grey[:-1]
    across = grey[1:, 1:] - grey[:-1, :-1], grey[1:, :-1] - grey[:-1, 1:]
    sizes = ((np.abs(part).mean(), np.sqrt((part**2).mean())) for part in (*along, *across))
    return [_log(number) for pair in sizes for number in pair]


def _levels(grey: ndarray) -> list[float]:
    seen = grey[:: -(-grey.size // 2**17)].ravel().astype(int)
    upto = np.array([np.mean(seen <= level) for level in range(256)])
    low, median, high = (int(np.flatnonzero(upto >= share - 1e-15)[0]) for share in (0.05, 0.5, 0.95))
    inside = (seen > low + 0.25 * (high - low)) & (seen < high - 0.25 * (high - low))
    shares = (np.mean(seen == 0), np.mean(seen == 255), np.mean(inside))
    places = [(level + 1) / 256 for level in (low, median, high)]
    return [_log(seen.mean()), _log(seen.std()), *places, *(float(np.log(s + 1e-4)) for s in shares)]


def _profile(means: ndarray) -> list[float]:
    along = np.linspace(-1, 1, len(means))
    kinks = np.abs(np.diff(means, 2)) if len(means) > 2 else np.zeros(1)
    middle = float(means.astype(float) @ along) / max(float(means.sum()), FLOOR)
    return [middle, _log(float(kinks.max())), _log(float(kinks.mean()))]


def _markers(grey: ndarray) -> list[float]:
    level, brighter = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    labels, count = ndimage.label(brighter, np.ones((3, 3)))
    each = np.arange(1, count + 1)
    size = ndimage.sum_labels(np.ones_like(labels), labels, each)
    middles = np.array(ndimage.center_of_mass(np.ones_like(labels), labels, each)).reshape(-1, 2)[:, ::-1]
    large = size >= MIN_MARKER_PX
    specks = float(np.log1p(np.sum(~large)))
    if not large.any():
        return [level / 256, specks, *(0.0,) * 7]
    size, (height, width) = np.log(size[large]), grey.shape
    away = (middles[large] - ((width - 1) / 2, (height - 1) / 2)) / max(height, width)
    spread = (np.sqrt(np.mean(away**2)), np.mean(away[:, 0] * away[:, 1]))
    return [level / 256, specks, np.log(len(size)), np.median(size), size.std(), *away.mean(axis=0), *spread]
