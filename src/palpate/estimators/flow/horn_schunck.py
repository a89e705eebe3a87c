"""Dense optical flow by Horn and Schunck: the plain reference in double precision, and its settings.

The flow (u, v) [px/frame] minimises the squared change of brightness along the motion plus alpha^2 times the
squared gradients of u and v. Each iteration takes the neighbours' average and moves it towards the line on
which brightness is constant:

    (u, v) <- (ū, v̄) - (E_x, E_y) (E_x ū + E_y v̄ + E_t) / (alpha^2 + E_x^2 + E_y^2)

ū weighs the four nearest neighbours 1/6 and the four diagonal ones 1/12; all pixels are updated at once
(Jacobi), and beyond the border the flow repeats. After n iterations a pixel has heard from those at most n
away, hence n at least as large as the widest patch of even brightness: a pin, 26 px in the TacTip images of
Pagnanelli et al., "Model-Based Compliance Discrimination via Soft Tactile Optical Sensing and Optical Flow
Computation" (IEEE Robotics and Automation Letters).

The smoothness weight alpha has the unit of a brightness difference, so it means nothing before the scale of
brightness is fixed: here black is 0 and the greatest value of the image's type is 1.

Reference: B. K. P. Horn, B. G. Schunck, Determining optical flow, Artificial Intelligence 17 (1981) 185-203,
doi:10.1016/0004-3702(81)90024-2, sections 7 and 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from palpate.core import Float, ImageError, InputError, RangeError, Shaped, ndarray

WHITE = {np.dtype(np.uint8): 255.0, np.dtype(np.uint16): 65535.0}

Grey = Shaped[ndarray, "..."]  # [h w], which `brightness` checks: refusals are ours, with what to do
Brightness = Float[ndarray, "h w"]


def brightness(image: Grey) -> Brightness:
    """The image in double precision, black 0 and white 1.

    Raises:
        ImageError: not a grey image of 8 or 16 bits, nor one of floats in [0, 1].
    """
    image = np.asarray(image)
    if image.ndim != 2 or min(image.shape) < 2:
        raise ImageError(f"flow is of grey images [h w] of 2 x 2 px or more, got {list(image.shape)}")
    if image.dtype in WHITE:
        return image / WHITE[image.dtype]
    if not np.issubdtype(image.dtype, np.floating):
        raise ImageError(f"grey images are of uint8, uint16 or floats in [0, 1], got {image.dtype}")
    if not (np.isfinite(image).all() and image.min() >= 0 and image.max() <= 1):
        raise ImageError("an image of floats holds brightness in [0, 1], black to white; divide by its white")
    return image.astype(np.float64)


def check_pair(first: Grey, second: Grey) -> None:
    """Raise unless the two are of one shape and type."""
    if first.shape != second.shape or first.dtype != second.dtype:
        raise InputError(
            f"flow is between two images of one size and type, got {list(first.shape)} {first.dtype} and "
            f"{list(second.shape)} {second.dtype}"
        )


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


NEIGHBOURS = np.array([[1, 2, 1], [2, 0, 2], [1, 2, 1]]) / 12

Flow = Float[ndarray, "2 h w"]


@dataclass(frozen=True)
class HornSchunck:
    """Settings of the flow; the defaults are those of the TacTip report.

    Attributes:
        alpha: weight of smoothness, in units of brightness (white is 1) a pixel.
        iterations: Jacobi steps from no motion.
    """

    alpha: float = 0.1
    iterations: int = 26

    def __post_init__(self) -> None:
        if not (np.isfinite(self.alpha) and self.alpha > 0):
            raise RangeError(f"alpha is {self.alpha}; a positive brightness, 0.1 of white if in doubt")
        if self.iterations < 1:
            raise RangeError(f"{self.iterations} iterations; 1 or more, 26 if in doubt")


AS_REPORTED = HornSchunck()


def horn_schunck(first: Grey, second: Grey, settings: HornSchunck = AS_REPORTED) -> Flow:
    """Flow from the first image to the second, step by step as the equations stand.

    Args:
        first, second: grey images of one size; see `brightness`.
        settings: weight of smoothness and number of iterations.

    Returns:
        u (along columns) and v (along rows, downwards) [px/frame]. Motion beyond a pixel or so is
        under-estimated: brightness is taken as linear between the two images.

    Raises:
        ImageError, InputError: images that cannot be read as a pair.

    Example:
        >>> import numpy as np
        >>> still = np.zeros((20, 20), np.uint8)
        >>> float(abs(horn_schunck(still, still)).max())
        0.0
    """
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
