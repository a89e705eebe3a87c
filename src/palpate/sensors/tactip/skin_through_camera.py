"""Inverse of the camera's view: from image positions of untouched pins to their roots on the skin."""

from __future__ import annotations

import math

import numpy as np

from palpate.core import Float, InputError, Int, Lens, ndarray
from palpate.estimators.compliance.pin_field import pin_field
from palpate.estimators.lattice.ring_layout import ring_of
from palpate.sensors.tactip.skin_and_markers import head_on
from palpate.sensors.tactip.tactip_camera import projected
from palpate.sensors.tactip.tactip_press import pixels_per_tangent
from palpate.sensors.tactip.tactip_spec import TacTipSpec

NODES = 400
REACH = 0.98  # maximum distance of pins over the skin's inner radius

Places = Float[ndarray, "p 2"]


def skin_places_m(spec: TacTipSpec, places_px: Places, lens: Lens | None = None) -> Places:
    """Return the roots of untouched pins projected along the tip's axis from their image positions [m].

    Args:
        spec: Tip, with the camera's height; without a lens also its scale.
        places_px: Marker positions.
        lens: Lens in air aligned with the tip's axis; None for the spec's camera.
    """
    if lens is None:
        middle = (spec.camera.size_px - 1) / 2
        tangent = (places_px - middle) / pixels_per_tangent(spec)
    else:
        rays = lens.rays(places_px)
        tangent = rays[:, :2] / rays[:, 2:]
    size = np.hypot(*tangent.T)
    root, seen = _ways_out(spec)
    if not (size <= seen[-1]).all():
        ends = float(np.nan_to_num(size, nan=np.inf).max()), float(seen[-1])
        widest, most = (math.degrees(math.atan(end)) for end in ends)
        raise InputError(
            f"a pin is seen {widest:.3g} degrees off the axis; on this dome none is beyond {most:.3g}: "
            "give the lens of this camera, and the sensor's own spec",
            code="lens-differs",
        )
    share = np.interp(size, seen, root) / np.maximum(size, 1e-12)
    return tangent * share[:, None]


def untouched_area_m2(
    spec: TacTipSpec, places_px: Places, cells: Int[ndarray, "p 2"] | None, lens: Lens | None = None
) -> float:
    """Return A_c0, the area pi r^2 of the circle through the outermost pins' roots, along the axis [m^2].

    Args:
        spec, lens: See `skin_places_m`.
        places_px: Pins of an untouched frame; NaN for lost ones.
        cells: Lattice cells from `find_pins`.
    """
    if cells is None:
        raise InputError("pins without lattice; use `find_pins` on a reference frame", code="no-lattice")
    rings = int(ring_of(cells).max())
    if rings != spec.pins.rings:
        raise InputError(
            f"{rings} rings of pins are seen, and this sensor has {spec.pins.rings}; give the sensor's own "
            "spec, and an untouched frame that shows all rings",
            code="pin-count",
        )
    seen = np.isfinite(places_px).all(axis=1)
    return pin_field(skin_places_m(spec, places_px[seen], lens), cells[seen]).area


def _ways_out(spec: TacTipSpec) -> tuple[Float[ndarray, " n"], Float[ndarray, " n"]]:
    """Distances of roots from the axis [m], and tangents at which their markers appear."""
    root = np.linspace(0.0, REACH * spec.inner_radius_m, NODES)
    skin = head_on(spec.table.press(math.inf), spec.table.radius_m, 0.0, (0.0, 0.0))
    places, normals = skin.at(np.arcsin(root / spec.inner_radius_m), np.zeros(NODES))
    tangent, _ = projected(places + spec.pins.length_m * normals, spec.camera, spec.table.radius_m)
    seen = tangent[:, 0] - tangent[0, 0]
    end = int(np.argmax(np.diff(seen) <= 0)) or NODES - 1
    return root[: end + 1], seen[: end + 1]
