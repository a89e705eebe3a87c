"""Fringe order against load, from what one place in a polariscope looks like at several loads.

Each patch of the photograph passes, in colour channel c and at load P,

    v_c = b_c + a_c S_c(N),   S_c(N) = sum_k w_kc sin^2(pi N l0 C(l_k) / (l_k C(l0))),   N = k P + N0,

with the gain a and the leak b of every patch and channel unknown. Many k fit nearly as well as each other, so
all are tried on a grid (`fringe_search`); the best few are refined by robust least squares, soft L1, patch by
patch, since stress may differ between patches. What comes back is the patches' mean of k.

A photograph's errors (lamp, exposure, load) are shared by all its patches, so the photographs are what is
counted: the interval is Student's, with 4 unknowns, from the scatter of whole photographs about the fit, and
the scatter of k between patches is added to it.

Reference for S: J. W. Dally and W. F. Riley, Experimental Stress Analysis, on the dark-field polariscope.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from palpate.core import Bool, Float, InputError, RangeError, ndarray
from palpate.estimators.fringe_light import Polariscope
from palpate.estimators.fringe_search import MIN_ORDER, Fit, Traces, candidates, refined

MIN_PHOTOGRAPHS = 5  # one more than the unknowns k, N0, a and b
MIN_LOADS = 4
RIVAL = 0.05  # share of the best fit's likelihood from which another slope is called as good
_DULL = 0.1  # a channel that changes less than this share of the liveliest one is left out

Light = Float[ndarray, "n p c"]


@dataclass(frozen=True, slots=True)
class OrderCandidate:
    """Another slope that the photographs allow.

    Attributes:
        slope_per_n: k [1/N].
        likelihood: of the photographs under it, over that under the best slope; 0 to 1.
    """

    slope_per_n: float
    likelihood: float


@dataclass(frozen=True, slots=True)
class OrderFit:
    """Fringe orders of a series of photographs, and the line through them.

    Attributes:
        slope_per_n: k, orders per newton [1/N].
        half_width_per_n: of its 95 % interval [1/N].
        residual_order: N0, the order without load.
        order: k P + N0 of each photograph.
        own_order: order that each photograph shows by itself, near the line (within 0.25).
        own_low: lower end of its 95 % interval.
        own_high: upper end.
        channels: which channels were used.
        gain: a of each channel, mean over the patches, in the light's unit; 0 where a channel is not used.
        leak: b likewise; the mean light where a channel is not used.
        rms: of the residuals, as a share of each patch's range of brightness.
        spread: standard deviation of k between patches, as a share of k.
        rivals: other slopes, best first; those with a likelihood above 0.05 make the fit ambiguous.
    """

    slope_per_n: float
    half_width_per_n: float
    residual_order: float
    order: Float[ndarray, " n"]
    own_order: Float[ndarray, " n"]
    own_low: Float[ndarray, " n"]
    own_high: Float[ndarray, " n"]
    channels: tuple[int, ...]
    gain: Float[ndarray, " c"]
    leak: Float[ndarray, " c"]
    rms: float
    spread: float
    rivals: tuple[OrderCandidate, ...] = field(default=())

    @property
    def ambiguous(self) -> bool:
        """True if another slope fits nearly as well."""
        return any(rival.likelihood > RIVAL for rival in self.rivals)


def fit_orders(
    load_n: Float[ndarray, " n"],
    light: Light,
    polariscope: Polariscope,
    *,
    clipped: Bool[ndarray, "n p c"] | None = None,
    open_light: Float[ndarray, "p c"] | None = None,
    greatest_order: float = 6.0,
    residual_order: float = 0.05,
) -> OrderFit:
    """Orders per newton from the light of some patches at several loads.

    Args:
        load_n: load of each photograph, not negative [N].
        light: linear light of each photograph, patch and channel, any common scale, exposure divided out.
        polariscope: with as many channels as `light`.
        clipped: where the camera was saturated; such light may be greater than it is written.
        open_light: of the unloaded specimen between parallel polarisers, on the same scale. It fixes the
            gain, and is needed where the loads turn less than about half an order.
        greatest_order: at the greatest load; slopes up to it are tried.
        residual_order: one standard deviation of what N0 may be, before any photograph is seen.

    Returns:
        The fit. Its interval holds scatter, N0 and unevenness; not the error of a wrong wavelength.

    Raises:
        InputError: too few photographs or loads, shapes that differ, values that are no light, or no change
            of light with load.
        RangeError: the scan's range is empty, the best slope lies at an end of it, or its interval reaches 0.
    """
    clipped = np.zeros(light.shape, dtype=bool) if clipped is None else clipped
    _check(load_n, light, polariscope, greatest_order, residual_order)
    traces = Traces.of(load_n, light, clipped, open_light, polariscope, _lively(light), residual_order)
    fits = refined(traces, candidates(traces, greatest_order))
    best = fits[0]
    half = best.half_width()
    if not half < best.slope:
        raise RangeError(
            f"the photographs do not tell the orders per newton: {best.slope:.3g} ± {half:.2g} 1/N reaches "
            "zero; load more, take more photographs, or move the region to where the stress is uniform"
        )
    rivals = [_rival(fit, best) for fit in fits[1:] if fit.whole and abs(fit.slope - best.slope) > half]
    return _summary(light, traces, best, sorted(rivals, key=lambda rival: -rival.likelihood))


def _summary(light: Light, traces: Traces, best: Fit, rivals: list[OrderCandidate]) -> OrderFit:
    own, low, high = best.own_orders()
    used = list(traces.channels)
    gain, leak = np.zeros(light.shape[2]), light.mean(axis=(0, 1))
    gain[used], leak[used] = ((share * traces.scale).mean(axis=0) for share in best.gain_and_leak())
    return OrderFit(
        slope_per_n=best.slope,
        half_width_per_n=best.half_width(),
        residual_order=best.offset,
        order=best.slope * traces.load_n + best.offset,
        own_order=own,
        own_low=low,
        own_high=high,
        channels=traces.channels,
        gain=gain,
        leak=leak,
        rms=float(np.sqrt(best.cost)),
        spread=float(np.std(best.slopes) / best.slope),
        rivals=tuple(rivals),
    )


def check_loads(load_n: Float[ndarray, " n"]) -> None:
    """Refuse a series of loads [N] from which no slope can be told.

    Raises:
        RangeError: a load is negative or no number.
        InputError: there are too few photographs or too few different loads.
    """
    if not (np.isfinite(load_n).all() and (load_n >= 0).all()):
        raise RangeError("a load is negative or no number; give loads of 0 N or more")
    photographs, loads = len(load_n), len(np.unique(load_n))
    if photographs < MIN_PHOTOGRAPHS or loads < MIN_LOADS:
        raise InputError(
            f"{photographs} photograph(s) at {loads} load(s) cannot tell slope, residual order, gain and "
            f"leak apart; take {MIN_PHOTOGRAPHS} or more at {MIN_LOADS} or more different loads"
        )


def _rival(fit: Fit, best: Fit) -> OrderCandidate:
    # With an unknown noise the likelihood goes as the sum of squares to the power -freedom / 2.
    ratio = max(best.cost, 1e-12) / max(fit.cost, 1e-12)
    return OrderCandidate(fit.slope, float(min(ratio ** (fit.freedom() / 2), 1.0)))


def _lively(light: ndarray) -> tuple[int, ...]:
    """Channels whose light changes with load."""
    change = np.ptp(light, axis=0).mean(axis=0)
    if not change.max() > 0:
        raise InputError(
            "the light in the region is the same at every load; move the region onto the specimen, or load "
            "more"
        )
    return tuple(int(c) for c in np.flatnonzero(change >= _DULL * change.max()))


def _check(
    load_n: ndarray, light: ndarray, polariscope: Polariscope, greatest_order: float, residual_order: float
) -> None:
    if len(load_n) != len(light) or light.shape[2] != polariscope.spectrum.weight.shape[1]:
        raise InputError(
            f"{len(load_n)} loads and light of shape {light.shape} do not belong to one series of "
            f"{polariscope.spectrum.weight.shape[1]} channels"
        )
    check_loads(load_n)
    if not (np.isfinite(light).all() and (light >= 0).all()):
        raise InputError("some light is negative or no number; give linear light of 0 or more")
    if not (np.isfinite(greatest_order) and greatest_order > 2 * MIN_ORDER):
        raise RangeError(f"greatest order {greatest_order} is not above {2 * MIN_ORDER}; 6 is usual")
    if not 0.0 < residual_order <= 0.5:
        raise RangeError(f"residual order {residual_order} is outside 0 (excluded) to 0.5; 0.05 is usual")
