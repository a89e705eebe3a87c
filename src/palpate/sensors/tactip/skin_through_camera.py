"""Where on the skin a camera sees a pin: from a place in the image back to the root of the pin, in metres.

The way out is `tactip_camera.projected`: a pin stands on the untouched dome, its marker is seen through gel
and window. It is steady in the distance from the axis, so that it can be read backwards.
"""

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
REACH = 0.98  # of the skin's inner radius, to which pins are looked for

Places = Float[ndarray, "p 2"]


def skin_places_m(spec: TacTipSpec, places_px: Places, lens: Lens | None = None) -> Places:
    """Roots of untouched pins as seen along the tip's axis, from where their markers are in the image [m].

    Args:
        spec: of the tip: dome, pins' length, gel and the camera's height; without a lens also the camera's
            scale.
        places_px: of markers.
        lens: of the camera in air, whose axis is the tip's; None for the spec's own camera.
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
    """A_c0: the circle about the middle pin through the outermost ones, on the skin along the axis [m^2].

    It is pi r^2 with r the distance of the outermost roots from the middle one, by all that the lattice has
    on its edge; a pin that is hidden counts where the others say it stands.

    Args:
        spec, lens: see `skin_places_m`.
        places_px: of the pins of an untouched frame; NaN where one is lost.
        cells: of each on the lattice, as `find_pins` names them.
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
    """Distances of roots from the axis [m], and the tangents under which their markers are seen."""
    root = np.linspace(0.0, REACH * spec.inner_radius_m, NODES)
    skin = head_on(spec.table.press(math.inf), spec.table.radius_m, 0.0, (0.0, 0.0))
    places, normals = skin.at(np.arcsin(root / spec.inner_radius_m), np.zeros(NODES))
    tangent, _ = projected(places + spec.pins.length_m * normals, spec.camera, spec.table.radius_m)
    seen = tangent[:, 0] - tangent[0, 0]
    end = int(np.argmax(np.diff(seen) <= 0)) or NODES - 1
    return root[: end + 1], seen[: end + 1]
