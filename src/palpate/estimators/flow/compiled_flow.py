"""The flow of `horn_schunck`, compiled and in single precision.

Between TacTip frames it agrees with the plain reference to 5e-6 px. It releases the interpreter's lock, so
that the pairs of a sequence may be shared by threads; see `flow_sequence`.
"""

from __future__ import annotations

import math
from threading import local

import numpy as np

from palpate.core import Bool, Float32, ndarray
from palpate.estimators.flow.horn_schunck import AS_REPORTED, WHITE, Grey, HornSchunck, brightness, check_pair

FlowField = Float32[ndarray, "2 h w"]


class _Workspace(local):
    """Workspace that one thread writes into again and again, laid out as `flow_kernels` says."""

    shape: tuple[int, int, int] = (0, 0, 0)

    def of(self, iterations: int, h: int, w: int) -> tuple[ndarray, ndarray, ndarray, ndarray]:
        from palpate.estimators.flow.flow_kernels import RING, row_length

        if self.shape != (iterations, h, w):
            row = row_length(w)
            self.a, self.b = _aligned(h, row), _aligned(h, row)
            self.e = _aligned(h, 3, row)
            self.rows = _aligned(iterations + 1, RING, 2, row)
            self.shape = (iterations, h, w)
        return self.a, self.b, self.e, self.rows


def _aligned(*shape: int) -> ndarray:
    """Zeros, at an address that whole cache lines start from."""
    size = math.prod(shape)
    spare = np.zeros(size + 16, np.float32)
    first = -spare.ctypes.data // 4 % 16
    return spare[first : first + size].reshape(shape)


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
    mask: Bool[ndarray, "h w"] | None = None,
) -> FlowField:
    """Flow from the first image to a second that was perhaps warped [px/frame].

    Args:
        first, second: grey images of one size and type; see `brightness`.
        settings: weight of smoothness and number of iterations.
        about: the flow that the second image was warped by, where the iterations start; None for none.
        mask: where the second image shows something; elsewhere only smoothness speaks.

    Raises:
        ImageError, InputError: images that cannot be read as a pair.
    """
    from palpate.estimators.flow import flow_kernels  # here: compiling is for those who need flow

    first, second = np.asarray(first), np.asarray(second)
    check_pair(first, second)
    white = _white(first)
    if white is None:
        first, second, white = brightness(first), brightness(second), 1.0
    h, w = first.shape
    a, b, e, rows = _WORKSPACE.of(settings.iterations, h, w)
    for image, levels in ((first, a), (second, b)):
        levels[:, :w] = image
        levels[:, w] = image[:, -1]
    flow_kernels.coefficients(a, b, w, np.float32(0.25 / white), np.float32(settings.alpha**2), e)
    flow = np.zeros((2, h, w), np.float32)
    e_x, e_y, e_t = (e[:, i, :w] for i in range(3))
    if mask is not None:
        e[:, :, :w] *= mask[:, None]
    if about is not None:
        e_t -= e_x * about[0] + e_y * about[1]
        flow[:] = about
    flow_kernels.relax(e, settings.iterations, rows, flow)
    return flow


def _white(image: Grey) -> float | None:
    """The level that is white in an image of whole ones, which single precision holds exactly."""
    whole = image.ndim == 2 and min(image.shape) > 1
    return WHITE.get(image.dtype) if whole else None


def divergence(field: FlowField) -> Float32[ndarray, "h w"]:
    """du/dx + dv/dy [1/frame] by three-point differences, one-sided on the border."""
    from palpate.estimators.flow import flow_kernels

    out = np.empty(field.shape[1:], np.float32)
    flow_kernels.diverge(np.ascontiguousarray(field, np.float32), out)
    return out
