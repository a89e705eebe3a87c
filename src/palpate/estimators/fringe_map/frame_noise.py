"""Noise of a camera's light, and the scale on which it is the same at every light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.stats import chi2

from palpate.core import Float, InputError, RangeError, ndarray

MIN_READ = 5e-4  # of light 1: what eight bits leave in the dark
BINS = 12
SECOND_DIFFERENCE = 6.0  # variances in a - 2 b + c
MIN_PIXELS = 1000


@dataclass(frozen=True, slots=True)
class FrameNoise:
    """Variance of a pixel's light v: read^2 + shot v."""

    read: float
    shot: float = 0.0

    def __post_init__(self) -> None:
        if not (0 < self.read < 1 and 0 <= self.shot < 1):
            raise RangeError(
                f"noise of {self.read} in the dark and {self.shot} by light; allowed are 0 to 1",
                code="noise-range",
            )

    def standard(self, light: Float[ndarray, "*n"]) -> Float[ndarray, "*n"]:
        """Return light on a scale of constant unit standard deviation."""
        if self.shot < 1e-6 * self.read:
            return np.asarray(light / self.read)
        bright = 2 / self.shot * (np.sqrt(self.read**2 + self.shot * np.maximum(light, 0)) - self.read)
        return np.asarray(bright + np.minimum(light, 0) / self.read)


def measured_noise(light: Float[ndarray, "h w c"]) -> FrameNoise:
    """Return the noise by second differences along rows; narrow fringes and JPEG bias it."""
    # Light is that of other pixels than those whose difference is taken: else noise would sort itself.
    middle = ((light[:, 4:] + light[:, :-4]) / 2).reshape(-1)
    bent = (light[:, 3:-1] - 2 * light[:, 2:-2] + light[:, 1:-3]).reshape(-1) ** 2 / SECOND_DIFFERENCE
    if len(middle) < MIN_PIXELS:
        raise InputError(f"{light.shape[0]} × {light.shape[1]} px are too few to measure noise; give it")
    step = max(len(middle) // 200_000, 1)
    middle, bent = middle[::step], bent[::step]
    order = np.argsort(middle)
    parts = np.array_split(order, BINS)
    at = np.array([np.median(middle[part]) for part in parts])
    variance = np.array([np.median(bent[part]) for part in parts]) / chi2.median(1)
    share = 1 / np.maximum(variance, MIN_READ**2)  # alike in proportion
    columns = np.stack([np.ones(BINS), np.maximum(at, 0)], axis=1) * share[:, None]
    (read, shot), _ = nnls(columns, variance * share)
    return FrameNoise(max(float(np.sqrt(read)), MIN_READ), float(shot))
