"""Fringe order and axis of every pixel from frames of one wavelength: six steps, or a polarization camera.

Circularly polarized light leaves a retarder of order N and axis theta with the normalized Stokes vector

    s = (-sin 2pi N sin 2theta, sin 2pi N cos 2theta, cos 2pi N),

up to handedness. Six steps measure all of it, N up to folds at half orders; a polarization camera gives the
first two components and folds at quarter orders, below which it is read. Continuity from a position of known
order unfolds N and theta. The standard deviation comes from the redundancy of the frames.

References: E. A. Patterson and Z. F. Wang, Towards full field automated photoelastic analysis of complex
components, Strain 27 (1991) 49; K. Ramesh, T. Kasimayan and B. Neethi
Simon, Digital photoelasticity - a comprehensive review, J. Strain Analysis 46 (2011) 245,
doi:10.1177/0309324711401501.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label, maximum_filter, uniform_filter
from scipy.stats import chi2

from palpate.core import Bool, Float, Float32, InputError, UInt8, ndarray
from palpate.estimators.fringe_map.order_map import MAX_SIGMA, SATURATED, OrderMap, Untold
from palpate.estimators.fringe_map.phase_kernels import unwrap
from palpate.optics.colour import Tone, linear_light

# analyzers of the six steps: circular, equal and opposite to the light, and linear at 0, 45, 90, 135 degrees
SIX_STEPS = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], float)
# analysers of a polarisation camera: linear at 0, 45, 90 and 135 degrees
CAMERA = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], float)

GIVE = 0.08  # standard deviation of the difference between neighbouring pixels [orders]
TURNED = 20.0  # natural log of the likelihood: an axis at a right angle to its neighbours'
SURE = 50.0  # natural log, where there is no second choice
LEAD = 0.5  # natural log: neighbours alone decide, and a fold's two sides lie close
TEAR = 0.2  # orders between two pixels from which they are not joined
QUARTER = 0.25
FLAT = 0.9  # of the sine, where four frames fold
DENSE = 0.15  # orders a pixel, from which fringes are too dense to be followed
FOUR_DENSE = 0.04  # the same of four frames, whose folds show no step
CHANCE = 4.0  # standard deviations of one component that the greatest of 50 steps reaches by noise
CLOSE = 0.2  # of the Stokes vector, a step between neighbours that is easily followed
FOLD = 0.05  # orders (and sine) that separate a reference from the next branch
CONTRAST = 0.3  # by which the Stokes vector's length may differ from 1
FLOOR = 1e-4  # standard deviation [orders]
MIN_LIGHT = 0.01  # half the light of all: darker is no picture
MAX_ORDER = 20.0


def order_from_phases(
    frames: Float[ndarray, "n h w"],
    analysers: Float[ndarray, "n 3"],
    reference: tuple[int, int, float],
    *,
    greatest_order: float = 8.0,
    mask: Bool[ndarray, "h w"] | None = None,
    saturated: Bool[ndarray, "h w"] | None = None,
) -> OrderMap:
    """Return order and axis of every pixel from frames of one wavelength behind known analyzers.

    Args:
        frames: Linear light of each.
        analysers: Stokes vector of each analyzer without its intensity, `SIX_STEPS` or `CAMERA`.
        reference: Row, column, and order of one position.
        greatest_order: Greatest order searched; a quarter with four frames.
        mask: Pixels of the specimen.
        saturated: Pixels saturated in any frame.
    """
    n, h, w = frames.shape
    A = _matrix(n, analysers)
    row, column, known = reference
    whole = bool(A[:, 3].any())
    most = greatest_order if whole else QUARTER
    if not (0 <= row < h and 0 <= column < w and 0 <= known <= most <= MAX_ORDER):
        raise InputError(
            f"reference {reference} is outside of {w} × {h} px (row, column) or orders 0 to {most:g}",
            code="reference-outside",
        )
    for name, other in (("mask", mask), ("map of saturated pixels", saturated)):
        if other is not None and other.shape != (h, w):
            raise InputError(f"the frames are {w} × {h} px, and the {name} {other.shape[::-1]}")
    if not np.isfinite(frames).all() or not float(frames.mean()) > MIN_LIGHT / 2:
        raise InputError("the frames are dark or not finite; expose more", code="light-range")
    s, error, misfit = _stokes(frames, A)
    sine = np.hypot(s[0], s[1])
    order, axes, sigma = _folded(s, sine, error, whole, most)
    order, axes = order.reshape(h, w, -1), axes.reshape(h, w, -1, 2)
    clear = np.minimum(sine, 1.0).reshape(h, w).astype(np.float32)
    inside = np.ones((h, w), dtype=bool) if mask is None else mask
    burnt = np.zeros((h, w), dtype=bool) if saturated is None else saturated
    length = np.sqrt((s**2).sum(axis=0)).reshape(h, w)
    kept = (np.abs(length - 1) < CONTRAST) if whole else (length < 1 + CONTRAST)
    first = _branch(order[row, column], known, float(clear[row, column]), (row, column))
    step = _greatest_step(s.reshape(3, h, w), 3 if whole else 5)
    dense = step > 2 * np.sin(np.pi * (DENSE if whole else FOUR_DENSE)) + CHANCE * float(np.median(error))
    # Where fringes are dense a path may jump over a fold: it goes where steps are small first.
    quality = (0.2 + clear) / (1 + (step / CLOSE) ** 2)
    quality = np.where(inside & ~burnt & kept & ~dense, quality, np.float32(-1)).astype(np.float32)
    if order.shape[-1] > 1:
        at, lead = unwrap(order, axes, clear, quality, (row, column, first), GIVE, TURNED)
    else:  # below a quarter order there is nothing to unfold
        at = np.where(quality >= 0, np.int8(0), np.int8(-1))
        lead = np.full((h, w), SURE, np.float32)
    N = _chosen(order, at)
    theta = np.arctan2(_chosen(axes[..., 1], at), _chosen(axes[..., 0], at)) / 2
    spread = np.where(at >= 0, sigma.reshape(h, w), np.float32(np.nan))
    why = np.zeros((h, w), np.uint8)
    why[spread > MAX_SIGMA] = Untold.FAINT
    why[lead < LEAD] = Untold.RIVAL
    why[at < 0] = Untold.APART
    if not whole:
        # By itself, and as the mean of nine: noise opens no gap in a fold, and a steep one closes.
        why[(clear >= FLAT) | (uniform_filter(clear, 3) >= FLAT)] = Untold.BEYOND
    why[dense] = Untold.DENSE
    why[~kept] = Untold.UNLIKE
    why[burnt] = Untold.SATURATED
    why[~inside] = Untold.OUTSIDE
    # At a fold both choices lie close together, and either joins what is on its two sides.
    joined = (why == Untold.TOLD) | (why == Untold.RIVAL)
    why[(why == Untold.TOLD) & ~_within_reach(N, joined, row, column)] = Untold.APART
    return OrderMap(N, spread, lead, theta.astype(np.float32), misfit.reshape(h, w), why)


class CameraReader:
    """Read the raw frames of a polarization camera one by one, below a quarter order.

    Args:
        reference: Row, column, and order of one position of the first frame, in 2 by 2 raw pixels.
        mask: Pixels of the specimen.
        tone: Tone curve of the frames.
    """

    def __init__(
        self,
        reference: tuple[int, int, float],
        *,
        mask: Bool[ndarray, "h w"] | None = None,
        tone: Tone = "linear",
    ) -> None:
        self.reference, self.mask, self.tone = reference, mask, tone

    def read(self, image: UInt8[ndarray, "h2 w2"], before: OrderMap | None = None) -> OrderMap:
        """Return the orders of one frame, continuing from a position of the previous result."""
        place = self.reference if before is None or not before.valid.any() else best_place(before)
        frames = split_mosaic(image)
        burnt = np.asarray(frames.max(axis=0) >= SATURATED)
        return order_from_phases(
            linear_light(frames, self.tone), CAMERA, place, mask=self.mask, saturated=burnt
        )


def best_place(found: OrderMap) -> tuple[int, int, float]:
    """Return a reference position where phases identify the branch best."""
    if not found.valid.any():
        raise InputError("no pixel of the map before is told; give the order of a place of this frame")
    fold = np.abs(np.where(found.valid, found.order, 0.0) % QUARTER - QUARTER / 2)
    row, column = np.unravel_index(int(np.where(found.valid, fold, 1.0).argmin()), fold.shape)
    return int(row), int(column), float(found.order[row, column])


def split_mosaic(raw: UInt8[ndarray, "h w"]) -> UInt8[ndarray, "4 h2 w2"]:
    """Return the 0, 45, 90, and 135 degree frames of a mosaic (90, 45 over 135, 0), half as large."""
    if raw.ndim != 2 or raw.shape[0] % 2 or raw.shape[1] % 2:
        raise InputError(f"a raw frame of a polarisation camera is grey and of even size, not {raw.shape}")
    return np.stack([raw[1::2, 1::2], raw[::2, 1::2], raw[::2, ::2], raw[1::2, ::2]])


def _matrix(n: int, analysers: Float[ndarray, "m 3"]) -> Float[ndarray, "n 4"]:
    """Light of each frame by the Stokes vector."""
    if len(analysers) == n:
        A = np.concatenate([np.ones((n, 1)), analysers], axis=1) / 2
        used = int(np.abs(A).any(axis=0).sum())
        if used >= 3 and np.linalg.matrix_rank(A) == used and n > used:
            return A
    raise InputError(
        f"{n} frames behind {len(analysers)} analysers; give six (SIX_STEPS) or four (CAMERA)",
        code="analyzer-count",
    )


def _stokes(frames: ndarray, A: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """Normalized Stokes vector of each pixel, its error, and the reduced misfit."""
    used = np.flatnonzero(np.abs(A).any(axis=0))
    n, B, flat = len(A), A[:, used], frames.reshape(len(frames), -1).astype(np.float32)
    stokes = np.linalg.pinv(B).astype(np.float32) @ flat
    left = ((flat - B.astype(np.float32) @ stokes) ** 2).sum(axis=0)
    freedom = n - len(used)
    noise = max(np.sqrt(float(np.median(left)) / chi2.median(freedom)), 1e-6)
    total = np.maximum(stokes[0], MIN_LIGHT * stokes[0].max())
    s = np.zeros((3, flat.shape[1]), np.float32)
    s[used[1:] - 1] = stokes[1:] / total
    error = noise * np.sqrt(np.linalg.inv(B.T @ B)[1, 1]) / total
    return s, error, (left / (freedom * noise**2)).astype(np.float32)


def _greatest_step(s: Float32[ndarray, "3 h w"], window: int) -> Float32[ndarray, "h w"]:
    """Greatest distance between the Stokes vectors of neighbours, within a window about each pixel."""
    step = np.zeros(s.shape[1:], np.float32)
    down = np.sqrt(((s[:, 1:] - s[:, :-1]) ** 2).sum(axis=0))
    across = np.sqrt(((s[:, :, 1:] - s[:, :, :-1]) ** 2).sum(axis=0))
    step[1:], step[:, 1:] = down, np.maximum(step[:, 1:], across)
    return np.asarray(maximum_filter(step, window))


def _folded(
    s: Float32[ndarray, "3 p"], sine: ndarray, error: ndarray, whole: bool, greatest: float
) -> tuple[Float32[ndarray, "p k"], Float32[ndarray, "p k 2"], Float32[ndarray, " p"]]:
    """Orders and doubled axes (cosine, sine) that each Stokes vector allows, and standard deviations."""
    phase = np.arctan2(sine, s[2]) if whole else np.arcsin(np.minimum(sine, 1.0))
    share = phase / (2 * np.pi)
    unit = np.stack([s[1], -s[0]], axis=1) / np.maximum(sine, 1e-9)[:, None]
    orders, axes = [], []
    for n in range(int(greatest) + 2):
        for N, axis in ((n + share, unit), (n - share, -unit)):
            if n - 0.5 <= greatest and not (n == 0 and axis is not unit):
                orders.append(np.where(greatest >= N, N, np.nan))
                axes.append(axis)
    # At a right angle the sine alone is flat: what noise leaves of the phase is its square root.
    sigma = error / (2 * np.pi)
    if not whole:
        cosine = np.sqrt(np.maximum(1 - np.minimum(sine, 1.0) ** 2, 0))
        sigma = np.minimum(error / np.maximum(cosine, 1e-9), np.sqrt(2 * error)) / (2 * np.pi)
    return (
        np.stack(orders, axis=1).astype(np.float32),
        np.stack(axes, axis=1).astype(np.float32),
        np.hypot(sigma, FLOOR).astype(np.float32),
    )


def _branch(orders: Float32[ndarray, " k"], known: float, clear: float, place: tuple[int, int]) -> int:
    """Which of a position's orders is the known one."""
    distance = np.abs(np.where(np.isnan(orders), np.inf, orders) - known)
    nearest = np.sort(distance)
    if nearest.size > 1 and (nearest[1] - nearest[0] < FOLD or clear < FOLD):
        raise InputError(
            f"order {known:g} at row {place[0]}, column {place[1]} is at a fold; choose another, an eighth "
            "of an order away",
            code="phase-folded",
        )
    if nearest[0] > QUARTER / 2:
        raise InputError(
            f"row {place[0]}, column {place[1]} has order {float(orders[distance.argmin()]):.3f}, not "
            f"{known:g} (off by {nearest[0]:.2f}); check the order of frames",
            code="frame-order",
        )
    return int(distance.argmin())


def _within_reach(order: ndarray, told: ndarray, row: int, column: int) -> Bool[ndarray, "h w"]:
    """Pixels connected to a position by small steps of order."""
    whole = told.copy()
    for axis in (0, 1):
        torn = np.abs(np.diff(np.where(told, order, 0.0), axis=axis)) > TEAR
        both = np.diff(told.astype(np.int8), axis=axis) == 0
        at = np.nonzero(torn & both)
        whole[at] = False
        whole[at[0] + (axis == 0), at[1] + (axis == 1)] = False
    parts, _ = label(whole)
    return np.asarray(whole & (parts == parts[row, column]) & (parts > 0))


def _chosen(values: Float32[ndarray, "h w k"], at: ndarray) -> Float32[ndarray, "h w"]:
    taken = np.take_along_axis(values, np.maximum(at, 0).astype(np.intp)[..., None], axis=2)[..., 0]
    return np.where(at >= 0, taken, np.float32(np.nan))
