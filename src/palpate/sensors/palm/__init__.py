"""The photoelastic palm: a clear disc between crossed polarisers, seen edge-on and through a mirror.

Errors: `InputError` for a wrong kind, name, or non-finite value; `RangeError` for a value outside a design's
or law's range; `ImageError` for a picture that does not fit; `LabelError` for a wrong label or table.
"""

from palpate.sensors.palm.fringe_orders import contact_summary
from palpate.sensors.palm.membrane_faults import Wear, worn
from palpate.sensors.palm.palm_press import has_table, press, press_to_force
from palpate.sensors.palm.palm_render import Views, expose, render, render_clean, render_raw, render_views
from palpate.sensors.palm.palm_spec import (
    PRESETS,
    PalmSpec,
    View,
    casting_resin,
    cropped,
    crops,
    debug,
    demo,
    palm,
    preset,
    small,
    solaris,
    sylgard_184,
)
from palpate.sensors.palm.probe_shapes import parse_probe

__all__ = [
    "PRESETS",
    "PalmSpec",
    "View",
    "Views",
    "Wear",
    "casting_resin",
    "contact_summary",
    "cropped",
    "crops",
    "debug",
    "demo",
    "expose",
    "has_table",
    "palm",
    "parse_probe",
    "preset",
    "press",
    "press_to_force",
    "render",
    "render_clean",
    "render_raw",
    "render_views",
    "small",
    "solaris",
    "sylgard_184",
    "worn",
]
