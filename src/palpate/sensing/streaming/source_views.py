"""The view without a calibration that suits a source: by a preset, or by a virtual sensor's own design.

What is shown of a patterned skin: its strain in the picture, its contacts, and how each has shifted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from palpate.core import Float, Image, ndarray
from palpate.core.sensor import Sensor, dark_field_of
from palpate.estimators.shear import ShearReader, ShearTouch
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


DOTS = 24  # along the longer side of the skin
MIN_TOLD = 0.01  # shear that is told; below it is noise
ARROWS_MM = 0.05  # shift of a contact that is drawn an arrow for; the readings tell less


def strain_view(reader: ShearReader, touch: ShearTouch) -> dict[str, Any]:
    """Return the strain of a frame as plain values for a page, in pixels of the frame.

    Returns:
        "box" of the skin (x, y, width, height); "dots" (x, y, greatest engineering shear above `MIN_TOLD`);
        "greatest" of the skin; "spacing_px"; "contacts" (x, y); "shift" of a single contact ("start", "end",
        its magnification "times", and "mm"), else None. No dots for an undecodable frame.
    """
    fields = touch.fields
    box = _box(reader)
    if fields is None:
        return {"box": box, "dots": [], "greatest": None, "spacing_px": 0.0, "contacts": [], "shift": None}
    every = max(1, -(-max(fields.at.shape[1:]) // DOTS))
    at = fields.at[:, every // 2 :: every, every // 2 :: every].reshape(2, -1).T
    shear = np.asarray(fields.greatest_shear)[every // 2 :: every, every // 2 :: every].ravel()
    seen = np.isfinite(shear) & np.isfinite(at).all(axis=1)
    spacing = np.hypot(*(fields.at[:, every, every] - fields.at[:, 0, 0])) / np.sqrt(2) if seen.any() else 0.0
    shown = seen & (shear > MIN_TOLD)
    dots = _in_image(reader, at[shown])
    contacts = np.array([[one.x, one.y] for one in touch.places.contacts]).reshape(-1, 2)
    greatest = np.asarray(fields.greatest_shear)
    return {
        "box": box,
        "dots": [
            [round(float(x), 1), round(float(y), 1), round(float(g), 4)]
            for (x, y), g in zip(dots, shear[shown], strict=True)
        ],
        "greatest": round(float(np.nanmax(greatest)), 4) if np.isfinite(greatest).any() else None,
        "spacing_px": round(float(spacing * reader.marks.px_per_unit), 1),
        "contacts": _in_image(reader, contacts).round(1).tolist(),
        "shift": _shift(reader, touch, contacts),
    }


def _shift(reader: ShearReader, touch: ShearTouch, contacts: Float[ndarray, "n 2"]) -> dict[str, Any] | None:
    """Arrow from the only contact along its shift; None where it has none, or less than `ARROWS_MM`."""
    found = [touch.readings.get(f"shift_{axis}_{reader.marks.unit}") for axis in "xy"]
    if len(contacts) != 1 or any(one is None or not one.valid for one in found):
        return None
    moved = np.array([float(getattr(one, "value", 0.0)) for one in found])
    length = float(np.hypot(*moved))
    if reader.marks.unit != "m" or 1e3 * length < ARROWS_MM:
        return None
    times = 10.0
    start, end = _in_image(reader, np.stack([contacts[0], contacts[0] + times * moved])).round(1).tolist()
    return {"start": start, "end": end, "times": times, "mm": round(1e3 * length, 3)}


def _box(reader: ShearReader) -> list[float]:
    """x, y, width and height of the untouched skin's marks, with half a pitch around them [px]."""
    at = reader.marks.in_image(reader.marks.reference.places)
    edge = reader.marks.pitch * reader.marks.px_per_unit / 2
    (left, top), (right, bottom) = at.min(axis=0) - edge, at.max(axis=0) + edge
    return [round(float(one), 1) for one in (left, top, right - left, bottom - top)]


def _in_image(reader: ShearReader, places: Float[ndarray, "n 2"]) -> Float[ndarray, "n 2"]:
    return np.asarray(reader.marks.in_image(places)) if len(places) else np.zeros((0, 2))
