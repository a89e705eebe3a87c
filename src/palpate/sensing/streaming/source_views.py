"""The view without a calibration that suits a source: by a preset, or by a virtual sensor's own design."""

from __future__ import annotations

from collections.abc import Sequence

from palpate.core import Image
from palpate.core.sensor import Sensor, dark_field_of
from palpate.sensing.live_sources import VIRTUAL
from palpate.sensing.untouched_view import UntouchedView
from palpate.sensors.owned import SensorPreset, preset_names, recognised_preset, sensor_preset


def preset_of_camera(address: str) -> SensorPreset | None:
    """The preset of the sensor that an address opens, where its camera or name is known; None else.

    Args:
        address: number, path or USB serial number of a camera, or ``virtual:NAME``.
    """
    if address.startswith(VIRTUAL):
        name = address.removeprefix(VIRTUAL)
        return sensor_preset(name) if name in preset_names() else None
    from palpate.rig.real.camera_listing import list_cameras

    path = f"/dev/video{address}" if address.isdecimal() and len(address) < 3 else address
    known = (one for one in list_cameras() if path in (one.path, one.serial))
    return next((found for one in known if (found := recognised_preset(one.name, one.usb_id))), None)


def view_of_source(
    frames: Sequence[Image], preset: SensorPreset | None = None, design: Sensor | None = None
) -> UntouchedView:
    """View of the untouched sensor, with what is known of it.

    Args:
        design: of a virtual sensor, where no preset is known; without both, all of the frame is looked at.
    """
    if preset is not None:
        return UntouchedView.of_preset(preset, frames)
    if design is None:
        return UntouchedView(frames)
    dark = dark_field_of(design)
    region = dark or design.regions()[design.axes.region]
    return UntouchedView(frames, region=region, dark_field=dark is not None)
