"""Touch on a patterned skin, frame by frame, from whatever holds frames: image, folder, run, video, TIFF.

Fringe orders frame by frame, as frames come from an image, a folder, a run, a video or a TIFF.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.calibration.shear import ForceFollower, ShearCalibration
from palpate.core import Frame, ImageError, InputError, PathText, Readings, storage_errors
from palpate.core.reading import Refusal
from palpate.estimators.fringe_map import ColourReader, OrderMap
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.shear import ShearReader, ShearTouch, TiledSkin
from palpate.estimators.surface_strain import StrainFields
from palpate.sensing.frame_sources import open_source


@dataclass(frozen=True, slots=True, eq=False)
class MappedFrame:
    """Fringe orders of one frame.

    Attributes:
        reason: Reason why there is no map; empty otherwise.
        latency_s: Time from the decoded image to the map [s].
    """

    index: int
    frame: Frame
    found: OrderMap | None
    reason: str = ""
    latency_s: float = 0.0

    @property
    def name(self) -> str:
        """Name of the frame; its index where it has none."""
        return self.frame.name or str(self.index)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        head: dict[str, Any] = {
            "frame": self.name,
            "time_s": self.frame.time_s,
            "read": self.found is not None,
        }
        if self.found is None:
            return {**head, "why": self.reason}
        return {**head, "why": "", "latency_ms": round(1e3 * self.latency_s, 2), **self.found.summary()}


def read_orders(
    frames: Iterable[Frame], reader: ColourReader, *, follow: bool = True
) -> Iterator[MappedFrame]:
    """Fringe orders of each frame, in order; one that cannot be read says why and does not end the sequence.

    Args:
        follow: each frame goes on from the one before, as far as light allows.
    """
    before: OrderMap | None = None
    for i, frame in enumerate(frames):
        if frame.fault:
            yield MappedFrame(i, frame, None, frame.fault)
            continue
        started = time.perf_counter()
        try:
            found = reader.read(frame.image, before if follow else None)
        except InputError as refusal:
            if i == 0:
                raise
            yield MappedFrame(i, frame, None, str(refusal))
            continue
        before = found
        yield MappedFrame(i, frame, found, latency_s=time.perf_counter() - started)


UNREADABLE = "no_image"


@dataclass(frozen=True, slots=True, eq=False)
class TouchedFrame:
    """Touch in one frame of a source.

    Attributes:
        touch: None for an undecodable frame or one of another size than the reference.
        reason: Reason why there is no touch; empty otherwise.
    """

    index: int
    frame: Frame
    touch: ShearTouch | None
    reason: str = ""

    @property
    def name(self) -> str:
        """Name of the frame; its index where it has none."""
        return self.frame.name or str(self.index)

    def to_dict(self) -> dict[str, Any]:
        """Frame, readings and all contacts as plain values for JSON."""
        head: dict[str, Any] = {"frame": self.name, "time_s": self.frame.time_s}
        if self.touch is None:
            return {
                **head,
                "read": False,
                "why": self.reason,
                "code": UNREADABLE,
                "readings": {},
                "contacts": [],
            }
        readings = {key: reading.to_dict() for key, reading in self.touch.readings.items()}
        if "force_N" in readings:
            force = self.touch.readings["force_N"]
            head |= {"calibration": force.calibration, "assumes": self.touch.assumes}
            head["drift"] = readings["force_N"]["drift"]
        contacts = [
            {"x": c.x, "y": c.y, "x_error": c.x_error, "y_error": c.y_error, "told_by": c.told_by}
            for c in self.touch.places.contacts
        ]
        verdict = {"read": not self.touch.reason, "why": self.touch.reason, "code": self.touch.code}
        return {**head, **verdict, "readings": readings, "contacts": contacts}


def first_frame(path: PathText) -> Frame:
    """The image at a path, or the first frame of what holds several."""
    with open_source(path) as frames:
        for frame in frames:
            if frame.fault:
                raise ImageError(f"{path}: {frame.name} cannot be read: {frame.fault}")
            return frame
    raise ImageError(f"{path} holds no frame")


class ForceInTouch:
    """Adds a calibration's normal force to the readings of a touch."""

    def __init__(self, calibration: ShearCalibration, reader: ShearReader) -> None:
        if reader.marks.unit != "m" or not isinstance(reader.skin, TiledSkin):
            raise InputError(
                "force is calibrated for tiled skins, as nusense; leave --skin or the calibration out"
            )
        if reader.skin.lens != calibration.lens:
            raise InputError(
                f"the calibration {calibration.id} was made through another lens; give that one by --lens, "
                "or calibrate anew"
            )
        self._marks = reader.marks
        self._follower = ForceFollower(calibration, self._in_pixels(reader.marks.reference))

    def added(self, touch: ShearTouch, frame: Frame, *, clocked: bool = True) -> ShearTouch:
        """The touch with a reading ``force_N``, not valid where gamma, of the same fields, is not.

        Without a clock the skin's memory is not used, since it fades by seconds and not by frames.
        """
        fields = touch.readings["gamma_ratio"]
        named = (frame.time_s, frame.name)
        if not fields.valid:
            force = self._follower.unread(Refusal(fields.code, fields.why), *named)
        else:
            force = self._follower.read(self._in_pixels(touch.points), *named, clocked=clocked)
        readings = Readings({**touch.readings, "force_N": force})
        return replace(touch, readings=readings, assumes=self._follower.calibration.assumes)

    def _in_pixels(self, points: ControlPoints) -> ControlPoints:
        scale = self._marks.px_per_unit
        return replace(
            points, places=self._marks.in_image(points.places), sigma=points.sigma * scale, unit="px"
        )


def read_touches(
    frames: Iterable[Frame], reader: ShearReader, force: ForceInTouch | None = None
) -> Iterator[TouchedFrame]:
    """What each frame shows, in order; one that cannot be read says why and does not end the sequence."""
    clocked = getattr(frames, "clocked", True)
    for i, frame in enumerate(frames):
        if frame.fault:
            yield TouchedFrame(i, frame, None, frame.fault)
            continue
        try:
            touch = reader.touch(frame)
        except InputError as refusal:
            if i == 0:
                raise
            yield TouchedFrame(i, frame, None, str(refusal))
            continue
        if force is not None:
            touch = force.added(touch, frame, clocked=clocked)
        yield TouchedFrame(i, frame, touch)


def write_fields(folder: Path, seen: TouchedFrame) -> None:
    """Write a frame's strain as ``000012.npz``, named by its index; nothing where it has none."""
    if seen.touch is None or seen.touch.fields is None:
        return
    with storage_errors(folder):
        np.savez_compressed(folder / f"{seen.index:06d}.npz", **field_arrays(seen.touch.fields))


def field_arrays(fields: StrainFields) -> dict[str, Any]:
    """Strain of a frame as named arrays ``[nv nu]``, NaN where marks are missing.

    x, y, displacement_x and displacement_y are in the fields' unit, `unit`; rotation is in rad, strains are
    plain numbers.
    """
    names = ("shear", "greatest_shear", "area_strain", "rotation_rad")
    return {
        "x": fields.at[0],
        "y": fields.at[1],
        "displacement_x": fields.displacement[0],
        "displacement_y": fields.displacement[1],
        "gradient": fields.gradient,
        **{name: getattr(fields, name) for name in names},
        "unit": fields.unit,
    }
