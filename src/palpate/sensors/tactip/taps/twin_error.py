"""By how much a fitted tip's pins are off, as a smooth function of the pose, learnt from few taps.

A twin leaves out how a real tip slips, leans and is seen. What it is off by is itself smooth, over the field
of pins and over poses: written in polynomials of the pins' places (`FieldModes`) every tap leaves some forty
numbers, and these are Gaussian processes of the pose with one kernel for all, a constant and a squared
exponential with a length for each coordinate, the lengths of greatest marginal likelihood (C. E. Rasmussen,
C. K. I. Williams, Gaussian Processes for Machine Learning, MIT Press 2006, chapter 5). What neither twin nor
process tells of a tap, its own slip, is their error with that tap left out.
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
LEADING = 12  # parts of the error, by which the kernel is chosen
USUAL_LENGTH, LENGTH_SPREAD = 1.5, 0.5  # of half a pose's range, and its natural logarithm's prior spread
CONSTANT = 0.3  # prior variance of the constant part, of the error's own
SHRUNK_AS = 10  # taps' worth of independence between parts, in the covariance of what is left

Poses = Float[ndarray, "t 6"]
Modes = Float[ndarray, "t m"]


@dataclass(frozen=True)
class FieldModes:
    """Polynomials of the place over a field of pins, orthonormal.

    Attributes:
        basis: of every pin ``[p k]``.
    """

    basis: Float[ndarray, "p k"]

    @classmethod
    def over(cls, rest_px: Float[ndarray, "p 2"], degree: int = MODE_DEGREE) -> FieldModes:
        """Modes of a field of pins at rest."""
        at = rest_px - np.median(rest_px, axis=0)
        return cls(np.linalg.qr(monomials(at / np.hypot(*at.T).max(), degree))[0])

    def of(self, moved_px: Float[ndarray, "t p 2"]) -> Modes:
        """Amplitudes of moves, along x and then y ``[t 2k]`` [px]; missing pins (NaN) do not count."""
        seen = np.isfinite(moved_px[..., 0])
        if seen.all():
            return np.concatenate([moved_px[..., 0] @ self.basis, moved_px[..., 1] @ self.basis], axis=1)
        return np.stack([self._seen(one, there) for one, there in zip(moved_px, seen, strict=True)])

    def _seen(self, moved_px: Float[ndarray, "p 2"], there: ndarray) -> Float[ndarray, " m"]:
        return np.asarray(np.linalg.lstsq(self.basis[there], moved_px[there], rcond=None)[0].T.ravel())

    def beside(self, moved_px: Float[ndarray, "t p 2"]) -> float:
        """Root mean square of a coordinate's move that is in no mode [px]."""
        x, y = np.split(self.of(moved_px), 2, axis=1)
        return float(np.sqrt(np.nanmean((moved_px - self.field(x, y)) ** 2)))

    def field(self, x: Modes, y: Modes) -> Float[ndarray, "t p 2"]:
        """Moves of amplitudes [px]."""
        return np.stack([x @ self.basis.T, y @ self.basis.T], axis=-1)


@dataclass(frozen=True)
class PoseScale:
    """Middle and half range of poses, by which they are made comparable."""

    middle: Float[ndarray, " 6"]
    half: Float[ndarray, " 6"]

    @classmethod
    def of(cls, poses: Poses) -> PoseScale:
        """The scale of some poses: their range."""
        low, high = poses.min(axis=0), poses.max(axis=0)
        return cls((low + high) / 2, (high - low) / 2)

    def scaled(self, poses: Poses) -> Poses:
        """Poses with a range of -1 to 1."""
        return np.asarray((poses - self.middle) / self.half)


@dataclass(frozen=True)
class TwinError:
    """A tip's error over poses.

    Attributes:
        scale: of poses.
        known: poses of the taps it was learnt from.
        off: amplitudes of the tip's error in these ``[t m]`` [px].
        lengths: of the kernel, in half ranges.
        amplitude, noise: standard deviations of what poses tell and of what they do not, over its own.
    """

    scale: PoseScale
    known: Poses
    off: Modes
    lengths: Float[ndarray, " 6"]
    amplitude: float
    noise: float

    @classmethod
    def learnt(cls, poses: Poses, off: Modes) -> TwinError:
        """The kernel of greatest posterior probability, of taps' errors."""
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
        """Inverse of the taps' covariance."""
        z = self.scale.scaled(self.known)
        K = _kernel(z, z, self.lengths, self.amplitude)
        return np.linalg.inv(K + self.noise**2 * np.eye(len(z)))

    @cached_property
    def weights(self) -> Modes:
        """Weights of the known taps."""
        return np.asarray(self.inverse @ self.off)

    @cached_property
    def left_out(self) -> Modes:
        """Each known tap's error beside what the others tell of it [px]."""
        return np.asarray(self.weights / np.diag(self.inverse)[:, None])

    @cached_property
    def covariance(self) -> Float[ndarray, "m m"]:
        """Covariance of what neither tip nor poses tell, shrunk where taps are few [px^2]."""
        off, count = self.left_out, len(self.left_out)
        C = off.T @ off / count
        share = SHRUNK_AS / (SHRUNK_AS + count)
        return np.asarray((1 - share) * C + share * np.diag(np.diag(C)))

    def at(self, poses: Poses, without: Int[ndarray, " t"] | None = None) -> Modes:
        """Amplitudes of the error at poses [px], each as if one known tap had not been seen."""
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
