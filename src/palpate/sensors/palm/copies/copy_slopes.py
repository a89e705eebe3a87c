"""Derivatives of a press's image by the unit's terms and the press's unknowns, by finite differences.

Depth, thickness, and the product E C nearly compensate each other, so their derivatives use all rays; those
of lamp, polariser, and lens use the fast rendering.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from palpate.core import Float, ndarray
from palpate.sensors.palm.copies.copy_force import thickness_is_free
from palpate.sensors.palm.copies.palm_copy import (
    AT,
    LOCAL,
    MODES,
    PARTS,
    RESIDUAL_MODES,
    TERMS,
    Local,
    PalmCopy,
)
from palpate.sensors.palm.copies.press_picture import Backdrop, Kept, Pixels, shown
from palpate.sensors.palm.fringe_view import columns_kept
from palpate.sensors.palm.uneven_membrane import side_modes

ONE_SIDED = {
    "lamp": 0.01, "polariser_rad": 2e-3, "ambient": 2e-3, "corner_loss": 0.02, "mired": 1.0,
}  # fmt: skip
EXACT = {
    "elevation_rad": 5e-3, "mirror_across_px": 0.25, "mirror_down_px": 0.25, "mirror_scale": 5e-3,
    "mirror_turn_rad": 5e-3, "fringes_turn_rad": 3e-3, "fringes_across_px": 0.3, "fringes_down_px": 0.3,
    "fringes_scale": 5e-3, "residual_along": 0.01, "residual_aside": 0.01,
}  # fmt: skip
ALL_RAYS = {"product": 0.01, "thickness": 0.01}
PLACE_STEPS = (3e-4, 3e-4, 0.02)  # of x, y [m] and ln(depth)
MIN_BLUR_PX = 0.15
NEAR = {
    "product": 0.03, "lamp": 0.1, "polariser_rad": 0.01, "elevation_rad": 0.01, "thickness": 0.01,
    "blur_px": 0.15,
}  # fmt: skip
NEAR_LOCAL = (1e-4, 1e-4, 0.02)
"""Changes of terms, and of position [m] and ln(depth), within which derivatives are reused."""


def picture_slopes(
    known: PalmCopy, local: Local, backdrop: Backdrop | None, kept: Kept | None = None
) -> Float[ndarray, "n u"]:
    """Return pixel derivatives by `TERMS` and `LOCAL`; 0 by E, which an image does not show alone."""
    draw = partial(shown, backdrop=backdrop, kept=kept)
    few = replace(known, spec=replace(known.spec, rays_per_pixel=(1, 1)))  # few rays suffice for most terms
    clean = known.terms.copy()
    clean[[i for name, i in AT.items() if name.startswith("residual")]] = 0.0
    clean[AT["blur_px"]] = max(clean[AT["blur_px"]], MIN_BLUR_PX)
    own = local.copy()
    own[LOCAL.index("residual_along") :] = 0.0

    def fast(name: str, step: float) -> Pixels:
        return draw(replace(few, terms=clean + step * _unit(name)), own, exact=False)

    def between(copy: PalmCopy, name: str, step: float) -> Pixels:
        ends = (draw(replace(copy, terms=copy.terms + s * step * _unit(name)), local) for s in (1, -1))
        return np.asarray((next(ends) - next(ends)) / (2 * step))

    base = fast("lamp", 0.0)
    J = np.zeros((len(base), len(TERMS) + len(LOCAL)))
    for name, step in ONE_SIDED.items():
        J[:, AT[name]] = (fast(name, step) - base) / step
    J[:, AT["blur_px"]] = (fast("blur_px", 0.1) - fast("blur_px", -0.1)) / 0.2
    for copy, steps in ((few, EXACT), (known, ALL_RAYS)):
        for name, step in steps.items():
            if name != "thickness" or thickness_is_free(known.spec):
                J[:, AT[name]] = between(copy, name, step)
    n = len(TERMS)
    for k, step in enumerate(PLACE_STEPS):
        off = step * (np.arange(len(LOCAL)) == k)
        at = known if LOCAL[k] == "log_depth" else few  # nearly cancels with the product
        J[:, n + k] = (draw(at, local + off) - draw(at, local - off)) / (2 * step)
    longer = own + 0.01 * (np.arange(len(LOCAL)) == 3)
    J[:, n + 3] = (draw(replace(few, terms=clean), longer, exact=False) - base) / 0.01
    shared = ("product", "thickness", "residual_along", "residual_aside")
    J[:, n + 4 : n + 8] = J[:, [AT[name] for name in shared]]
    over_view = _modes_at(known, local)
    for part in PARTS:
        J[:, [AT[one] for one in RESIDUAL_MODES[part]]] = over_view * J[:, [AT[f"residual_{part}"]]]
    for k, name in enumerate(("harder_across", "harder_along")):
        J[:, AT[name]] = J[:, AT["product"]] * local[k] / known.spec.radius_m
    return J


def _modes_at(known: PalmCopy, local: Local) -> Float[ndarray, "n m"]:
    """Modes of the residual birefringence at every pixel; 0 in the mirror."""
    spec = known.under(local).looks
    view, h = spec.fringes, spec.thickness_m
    across = columns_kept(spec.unlit).impact_m / spec.radius_m
    across, down = np.broadcast_arrays(
        np.nan_to_num(across), np.clip(2 * view.down_m[:, None] / h - 1, -1, 1)
    )
    modes = side_modes(across, down)[:MODES].reshape(MODES, -1)
    mirror = np.zeros((3 * spec.mirror.size_px[0] * spec.mirror.size_px[1], MODES))
    return np.concatenate([np.repeat(modes.T, 3, axis=0), mirror])


def _unit(name: str) -> Float[ndarray, " t"]:
    return (np.arange(len(TERMS)) == AT[name]).astype(float)


def still_near(one: tuple[ndarray, Local], other: tuple[ndarray, Local]) -> bool:
    """Return whether derivatives at one state are valid at another."""
    terms = all(abs(one[0][AT[name]] - other[0][AT[name]]) <= away for name, away in NEAR.items())
    return terms and bool(np.all(np.abs(one[1][:3] - other[1][:3]) <= NEAR_LOCAL))
