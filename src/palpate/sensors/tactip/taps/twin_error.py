"""Error of a fitted tip's pins as a smooth function of the pose, learned from few taps.

In polynomial modes of the pin field (`FieldModes`) every tap leaves about forty amplitudes, modeled as
Gaussian processes of the pose with one kernel: a constant and a squared exponential whose length scales
maximize the marginal likelihood (C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning,
MIT Press 2006, chapter 5).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from palpate.core import Float, Int, ndarray
from palpate.sensors.tactip.taps.pose_polynomial import monomials

MODE_DEGREE = 5
LEADING = 12  # principal components for the kernel's choice
USUAL_LENGTH, LENGTH_SPREAD = (
    1.5,
    0.5,
)  # prior length scale in half ranges, and standard deviation of its logarithm
CONSTANT = 0.3  # relative prior variance of the constant part
SHRUNK_AS = 10  # weight of the covariance's shrinkage to the diagonal, in taps

Poses = Float[ndarray, "t 6"]
Modes = Float[ndarray, "t m"]


@dataclass(frozen=True)
class FieldModes:
    """Orthonormal polynomials over a field of pins, with the basis ``[p k]``."""

    basis: Float[ndarray, "p k"]

    @classmethod
    def over(cls, rest_px: Float[ndarray, "p 2"], degree: int = MODE_DEGREE) -> FieldModes:
        at = rest_px - np.median(rest_px, axis=0)
        return cls(np.linalg.qr(monomials(at / np.hypot(*at.T).max(), degree))[0])

    def of(self, moved_px: Float[ndarray, "t p 2"]) -> Modes:
        """Amplitudes of displacements along x and then y [px]; NaN pins do not count."""
        seen = np.isfinite(moved_px[..., 0])
        if seen.all():
            return np.concatenate([moved_px[..., 0] @ self.basis, moved_px[..., 1] @ self.basis], axis=1)
        return np.stack([self._seen(one, there) for one, there in zip(moved_px, seen, strict=True)])

    def _seen(self, moved_px: Float[ndarray, "p 2"], there: ndarray) -> Float[ndarray, " m"]:
        return np.asarray(np.linalg.lstsq(self.basis[there], moved_px[there], rcond=None)[0].T.ravel())

    def beside(self, moved_px: Float[ndarray, "t p 2"]) -> float:
        """Rms of a coordinate's displacement outside the modes [px]."""
        x, y = np.split(self.of(moved_px), 2, axis=1)
        return float(np.sqrt(np.nanmean((moved_px - self.field(x, y)) ** 2)))

    def field(self, x: Modes, y: Modes) -> Float[ndarray, "t p 2"]:
        """Displacements of amplitudes [px]."""
        return np.stack([x @ self.basis.T, y @ self.basis.T], axis=-1)


@dataclass(frozen=True)
class PoseScale:
    """Middle and half range of poses."""

    middle: Float[ndarray, " 6"]
    half: Float[ndarray, " 6"]

    @classmethod
    def of(cls, poses: Poses) -> PoseScale:
        low, high = poses.min(axis=0), poses.max(axis=0)
        return cls((low + high) / 2, (high - low) / 2)

    def scaled(self, poses: Poses) -> Poses:
        """Poses scaled to -1 to 1."""
        return np.asarray((poses - self.middle) / self.half)


@dataclass(frozen=True)
class TwinError:
    """A tip's error over poses.

    Attributes:
        known: Poses of the training taps.
        off: Amplitudes of the tip's error in these [px].
        lengths: Length scales in half ranges.
        amplitude, noise: Standard deviations of the process and of its noise, relative to the error.
    """

    scale: PoseScale
    known: Poses
    off: Modes
    lengths: Float[ndarray, " 6"]
    amplitude: float
    noise: float

    @classmethod
    def learnt(cls, poses: Poses, off: Modes) -> TwinError:
        """Fit the kernel of maximum posterior probability."""
        scale = PoseScale.of(poses)
        z = scale.scaled(poses)
        u, s, _ = np.linalg.svd(off, full_matrices=False)
        leading = u[:, : min(LEADING, len(off))] * s[: min(LEADING, len(off))]
        leading /= np.sqrt(np.mean(leading**2, axis=0))

        def against(words: Float[ndarray, " 8"]) -> float:
            K = _kernel(z, z, np.exp(words[:6]), np.exp(words[6])) + np.exp(2 * words[7]) * np.eye(len(z))
            lower, _ = factor = cho_factor(K + 1e-8 * np.eye(len(z)), lower=True)
            misfit = (leading * cho_solve(factor, leading)).sum() / 2
            size = leading.shape[1] * np.log(np.diag(lower)).sum()
            prior = (((words[:6] - np.log(USUAL_LENGTH)) / LENGTH_SPREAD) ** 2).sum() / 2
            return float(misfit + size + prior)

        start = np.append(np.full(6, np.log(USUAL_LENGTH)), [0.0, np.log(0.5)])
        found = minimize(against, start, method="L-BFGS-B", bounds=[(-2, 3)] * 6 + [(-4, 2)] * 2).x
        return cls(scale, poses, off, np.exp(found[:6]), float(np.exp(found[6])), float(np.exp(found[7])))

    @cached_property
    def inverse(self) -> Float[ndarray, "t t"]:
        """Inverse covariance of the taps."""
        z = self.scale.scaled(self.known)
        K = _kernel(z, z, self.lengths, self.amplitude)
        return np.linalg.inv(K + self.noise**2 * np.eye(len(z)))

    @cached_property
    def weights(self) -> Modes:
        return np.asarray(self.inverse @ self.off)

    @cached_property
    def left_out(self) -> Modes:
        """Leave-one-out residuals [px]."""
        return np.asarray(self.weights / np.diag(self.inverse)[:, None])

    @cached_property
    def covariance(self) -> Float[ndarray, "m m"]:
        """Covariance of the leave-one-out residuals, shrunk for few taps [px^2]."""
        off, count = self.left_out, len(self.left_out)
        C = off.T @ off / count
        share = SHRUNK_AS / (SHRUNK_AS + count)
        return np.asarray((1 - share) * C + share * np.diag(np.diag(C)))

    def at(self, poses: Poses, without: Int[ndarray, " t"] | None = None) -> Modes:
        """Amplitudes of the error at poses [px]; with `without`, each as if one known tap were unknown."""
        z, known = self.scale.scaled(poses), self.scale.scaled(self.known)
        k = _kernel(z, known, self.lengths, self.amplitude)
        told = k @ self.weights
        if without is not None:
            told -= np.einsum("ti,it->t", k, self.inverse[:, without])[:, None] * self.left_out[without]
        return np.asarray(told)


def _kernel(
    one: Float[ndarray, "a 6"], other: Float[ndarray, "b 6"], lengths: Float[ndarray, " 6"], amplitude: float
) -> Float[ndarray, "a b"]:
    apart = (((one[:, None] - other[None]) / lengths) ** 2).sum(axis=2)
    return np.asarray(CONSTANT + amplitude**2 * np.exp(-apart / 2))
