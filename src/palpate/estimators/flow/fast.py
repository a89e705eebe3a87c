"""The flow of `horn_schunck`, compiled and in single precision.

Between TacTip frames it agrees with the plain reference to 1e-6 px. It releases the interpreter's lock, so
that the pairs of a sequence may be shared by threads; see `sequence`.
"""

from __future__ import annotations

from threading import local

import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray

from palpate.estimators.flow.brightness import WHITE, Grey, brightness, check_pair
from palpate.estimators.flow.horn_schunck import AS_REPORTED, HornSchunck

FlowField = Float32[ndarray, "2 h w"]


class _Workspace(local):
    """What one thread writes into again and again."""

    shape: tuple[int, int, int] = (0, 0, 0)

    def of(self, iterations: int, h: int, w: int) -> tuple[ndarray, ndarray]:
        if self.shape != (iterations, h, w):
            self.shape = (iterations, h, w)
            self.e = np.empty((3, h, w), np.float32)
            self.rows = np.empty((iterations, 2, 3, w + 2), np.float32)
        return self.e, self.rows


_WORKSPACE = _Workspace()


def flow(first: Grey, second: Grey, settings: HornSchunck = AS_REPORTED) -> FlowField:
    """Flow from the first image to the second [px/frame]; see `horn_schunck`.

    Raises:
        ImageError, InputError: images that cannot be read as a pair.
    """
    return relaxed(first, second, settings)


def relaxed(
    first: Grey,
    second: Grey,
    settings: HornSchunck,
    *,
    about: FlowField | None = None,
    seen: Bool[ndarray, "h w"] | None = None,
) -> FlowField:
    """Flow from the first image to a second that was perhaps warped [px/frame].

    Args:
        first, second: grey images of one size and type; see `brightness`.
        settings: weight of smoothness and number of iterations.
        about: the flow that the second image was warped by, where the iterations start; None for none.
        seen: where the second image shows something; elsewhere only smoothness speaks.

    Raises:
        ImageError, InputError: images that cannot be read as a pair.
    """
    from palpate.estimators.flow import kernels  # here: compiling is for those who need flow

    first, second = np.asarray(first), np.asarray(second)
    check_pair(first, second)
    (a, white), (b, _) = _levels(first), _levels(second)
    e, rows = _WORKSPACE.of(settings.iterations, *a.shape)
    kernels.coefficients(a, b, np.float32(0.25 / white), np.float32(settings.alpha**2), e)
    found = np.zeros((2, *a.shape), np.float32)
    if seen is not None:
        e *= seen
    if about is not None:
        e[2] -= e[0] * about[0] + e[1] * about[1]
        found[:] = about
    kernels.relax(e, settings.iterations, rows, found)
    return found


def _levels(image: Grey) -> tuple[Float32[ndarray, "h w"], float]:
    """Grey levels, exact for images of whole ones, and the level that is white."""
    whole = image.dtype in WHITE and image.ndim == 2 and min(image.shape) > 1
    levels = image if whole else brightness(image)
    return np.ascontiguousarray(levels, np.float32), WHITE[image.dtype] if whole else 1.0


def divergence(field: FlowField) -> Float32[ndarray, "h w"]:
    """du/dx + dv/dy [1/frame] by three-point differences, one-sided on the border."""
    from palpate.estimators.flow import kernels

    out = np.empty(field.shape[1:], np.float32)
    kernels.diverge(np.ascontiguousarray(field, np.float32), out)
    return out
