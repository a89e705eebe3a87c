"""Horn and Schunck's flow in double precision, step by step as the equations of `flow.horn_schunck` stand."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from palpate.core import Float, ndarray
from palpate.estimators.flow.horn_schunck import AS_REPORTED, Grey, HornSchunck, brightness, check_pair

Flow = Float[ndarray, "2 h w"]
Brightness = Float[ndarray, "h w"]
NEIGHBOURS = np.array([[1, 2, 1], [2, 0, 2], [1, 2, 1]]) / 12


def derivatives(first: Brightness, second: Brightness) -> tuple[Brightness, Brightness, Brightness]:
    """E_x, E_y and E_t [1/px, 1/px, 1/frame], each the mean of four differences along the cube's edges.

    The cube stands between the pixels (r, c), (r+1, c), (r, c+1), (r+1, c+1) and the two frames, so the
    derivatives are half a pixel right of and below the pixel they are stored at. x is along columns, y along
    rows, downwards; beyond the border the last row and column are repeated.
    """
    a, b = (np.pad(image, ((0, 1), (0, 1)), mode="edge") for image in (first, second))
    cube = np.stack([a, b])
    across = cube[:, :, 1:] - cube[:, :, :-1]
    down = cube[:, 1:] - cube[:, :-1]
    later = b - a
    e_x = (across[:, :-1] + across[:, 1:]).sum(axis=0) / 4
    e_y = (down[:, :, :-1] + down[:, :, 1:]).sum(axis=0) / 4
    e_t = (later[:-1, :-1] + later[:-1, 1:] + later[1:, :-1] + later[1:, 1:]) / 4
    return e_x, e_y, e_t


def horn_schunck(first: Grey, second: Grey, settings: HornSchunck = AS_REPORTED) -> Flow:
    """What `flow.horn_schunck.flow` gives [px/frame]."""
    check_pair(first, second)
    e_x, e_y, e_t = derivatives(brightness(first), brightness(second))
    weight = 1 / (settings.alpha**2 + e_x**2 + e_y**2)
    u, v = np.zeros((2, *e_x.shape))
    for _ in range(settings.iterations):
        u_mean = ndimage.correlate(u, NEIGHBOURS, mode="nearest")
        v_mean = ndimage.correlate(v, NEIGHBOURS, mode="nearest")
        off = (e_x * u_mean + e_y * v_mean + e_t) * weight
        u, v = u_mean - e_x * off, v_mean - e_y * off
    return np.stack([u, v])


def divergence(flow: Float[ndarray, "*n 2 h w"]) -> Float[ndarray, "*n h w"]:
    """du/dx + dv/dy [1/frame] by three-point differences, one-sided on the border."""
    u, v = flow[..., 0, :, :], flow[..., 1, :, :]
    return np.gradient(u, axis=-1) + np.gradient(v, axis=-2)
