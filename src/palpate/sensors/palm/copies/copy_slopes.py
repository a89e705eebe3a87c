"""Slopes of a press's picture over the copy's terms and the press's own unknowns.

Most are differences of pictures by the fast way. Those of thickness and residual birefringence, of which the
fast way is dear, are of exact ones; so are those over place, depth and where both regions lie, whose pictures
are sampled at points, and rough in them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from palpate.core import Float, ndarray
from palpate.sensors.palm.copies.copy_force import thickness_is_free
from palpate.sensors.palm.copies.palm_copy import AT, LOCAL, TERMS, Local, PalmCopy
from palpate.sensors.palm.copies.press_picture import Backdrop, Pixels, shown

ONE_SIDED = {
    "product": 0.01, "lamp": 0.01, "polariser_rad": 2e-3, "ambient": 2e-3, "corner_loss": 0.02, "mired": 1.0,
}  # fmt: skip
EXACT = {"thickness": 0.01, "residual_along": 0.01, "residual_aside": 0.01}
EXACT_BOTH = {
    "elevation_rad": 5e-3, "mirror_across_px": 0.25, "mirror_down_px": 0.25, "mirror_scale": 5e-3,
    "mirror_turn_rad": 5e-3, "fringes_turn_rad": 3e-3,
}  # fmt: skip
ALL_RAYS = {"fringes_across_px": 0.3, "fringes_down_px": 0.3, "fringes_scale": 5e-3}
PLACE_STEPS = (3e-4, 3e-4, 0.02)  # of x, y [m] and ln(depth)
MIN_BLUR_PX = 0.15
NEAR = {
    "product": 0.03, "lamp": 0.1, "polariser_rad": 0.01, "elevation_rad": 0.01, "thickness": 0.01,
    "blur_px": 0.15,
}  # fmt: skip
NEAR_LOCAL = (1e-4, 1e-4, 0.02)
"""Changes of terms, and of place [m] and ln(depth), within which slopes are taken to be the same."""


def picture_slopes(known: PalmCopy, local: Local, backdrop: Backdrop | None) -> Float[ndarray, "n u"]:
    """Slopes of pixels over `TERMS` and `LOCAL`, in this order; 0 over E, which no picture shows alone."""
    full, known = known, replace(known, spec=replace(known.spec, rays_per_pixel=(1, 1)))  # for most, few do
    clean = known.terms.copy()
    clean[[AT["residual_along"], AT["residual_aside"]]] = 0.0
    clean[AT["blur_px"]] = max(clean[AT["blur_px"]], MIN_BLUR_PX)
    own = local.copy()
    own[LOCAL.index("residual_along") :] = 0.0

    def fast(name: str, step: float) -> Pixels:
        at = replace(known, terms=clean + step * _unit(name))
        return shown(at, own, backdrop, exact=False)

    def exactly(name: str, step: float) -> Pixels:
        return shown(replace(known, terms=known.terms + step * _unit(name)), local, backdrop)

    base, whole = fast("lamp", 0.0), exactly("lamp", 0.0)
    J = np.zeros((len(base), len(TERMS) + len(LOCAL)))
    for name, step in ONE_SIDED.items():
        J[:, AT[name]] = (fast(name, step) - base) / step
    J[:, AT["blur_px"]] = (fast("blur_px", 0.1) - fast("blur_px", -0.1)) / 0.2
    for name, step in EXACT_BOTH.items():
        J[:, AT[name]] = (exactly(name, step) - exactly(name, -step)) / (2 * step)
    for name, step in EXACT.items():
        if name != "thickness" or thickness_is_free(known.spec):
            J[:, AT[name]] = (exactly(name, step) - whole) / step
    for name, step in ALL_RAYS.items():
        ends = [replace(full, terms=full.terms + sign * step * _unit(name)) for sign in (1, -1)]
        J[:, AT[name]] = (shown(ends[0], local, backdrop) - shown(ends[1], local, backdrop)) / (2 * step)
    n = len(TERMS)
    for k, step in enumerate(PLACE_STEPS):
        off = step * (np.arange(len(LOCAL)) == k)
        J[:, n + k] = (shown(known, local + off, backdrop) - shown(known, local - off, backdrop)) / (2 * step)
    longer = own + 0.01 * (np.arange(len(LOCAL)) == 3)
    J[:, n + 3] = (shown(replace(known, terms=clean), longer, backdrop, exact=False) - base) / 0.01
    shared = ("product", "thickness", "residual_along", "residual_aside")
    J[:, n + 4 : n + 8] = J[:, [AT[name] for name in shared]]
    for k, name in enumerate(("harder_across", "harder_along")):
        J[:, AT[name]] = J[:, AT["product"]] * local[k] / known.spec.radius_m
    return J


def _unit(name: str) -> Float[ndarray, " t"]:
    return (np.arange(len(TERMS)) == AT[name]).astype(float)


def still_near(one: tuple[ndarray, Local], other: tuple[ndarray, Local]) -> bool:
    """Whether slopes at one state, terms and a press's unknowns, serve at another."""
    terms = all(abs(one[0][AT[name]] - other[0][AT[name]]) <= away for name, away in NEAR.items())
    return terms and bool(np.all(np.abs(one[1][:3] - other[1][:3]) <= NEAR_LOCAL))
