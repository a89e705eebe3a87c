"""Reader of touch on a patterned skin: from a skin and an untouched frame to readings of later frames.

    reader = ShearReader(sensor.shear_skin(), untouched)
    touch = reader.touch(frame)
    touch.readings["x_mm"], touch.readings["edge_deg"], touch.readings["damage"]

No calibration is asked for, so that nothing is in newtons. What cannot be told is invalid and says why; a
skin that nothing touches has no place.
"""

from __future__ import annotations

from dataclasses import dataclass

from palpate.core import Frame, InputError, Lens, RangeError, Readings
from palpate.core.refusal import NONE, Refusal
from palpate.estimators.lattice import ControlPoints, DottedSkin
from palpate.estimators.shear.camera_motion import camera_motion
from palpate.estimators.shear.contact_reach import reach_of
from palpate.estimators.shear.frame_quality import look_at, pattern_box, why_unreadable
from palpate.estimators.shear.reference_check import refuse_reference
from palpate.estimators.shear.skin_damage import damage_of
from palpate.estimators.shear.skin_marks import DotMarks, SkinMarks, TiledSkin, TileMarks
from palpate.estimators.shear.slip_onset import SlipWatch
from palpate.estimators.shear.touch_places import TouchPlaces, touch_places
from palpate.estimators.shear.touch_readings import touch_readings
from palpate.estimators.surface_strain import StrainFields, StrainMeter

MIN_SEEN = 0.5  # of the reference's marks
NOTHING = TouchPlaces((), 0, None, None)


@dataclass(frozen=True, slots=True, eq=False)
class ShearTouch:
    """What one frame shows.

    Attributes:
        readings: of it, by their columns.
        points: its marks on the skin; none where the frame is not to be read.
        fields: their strain against the reference, degree 1; None as well.
        places: its contacts.
        reason: why the frame is not to be read; empty where it is.
        code: the same for programs.
        assumes: what a force in the readings assumes of the skin; empty without one.
    """

    readings: Readings
    points: ControlPoints
    fields: StrainFields | None
    places: TouchPlaces
    reason: str
    code: str = ""
    assumes: str = ""


class ShearReader:
    """Touch of later frames against an untouched one.

    Args:
        skin: tiles with their camera, as a sensor's `shear_skin` gives them, or a maker's dots.
        reference: frame of the untouched skin.
        lens: of dots' camera, in place of the description's own; tiles carry theirs.

    Raises:
        ImageError: a reference of another size than the lens's frames, without pattern, of another skin or
            through another lens, or with a touch in it.
        InputError: a second lens beside the one that tiles carry.
    """

    def __init__(self, skin: TiledSkin | DottedSkin, reference: Frame, lens: Lens | None = None) -> None:
        image = reference.image
        if isinstance(skin, TiledSkin) and lens is not None:
            raise InputError(
                "a tiled skin carries its lens; give one by dataclasses.replace(skin, lens=lens)"
            )
        self.skin = skin
        self.marks: SkinMarks = (
            TileMarks(skin, image) if isinstance(skin, TiledSkin) else DotMarks(skin, image, lens)
        )
        self.lattice = refuse_reference(self.marks, skin)
        self._box = pattern_box(self.marks.in_image(self.marks.reference.places), image.shape)
        self._look = look_at(image, self._box)
        self._meter = StrainMeter(self.marks.reference)
        self._slip = SlipWatch(self.marks.pitch)
        self._torn = f"a dark line crosses {self.marks.gap:.1f} tiles" if self.marks.gap else ""

    def read(self, frame: Frame) -> Readings:
        """Readings of the next frame; see `touch`."""
        return self.touch(frame).readings

    def touch(self, frame: Frame) -> ShearTouch:
        """What the next frame shows; frames come in their order, as marks are followed and slip is a change.

        Raises:
            InputError: a frame of another size or kind than the reference.
        """
        points, fields, refusal = self._seen(frame)
        places = NOTHING if fields is None else touch_places(fields, self.marks, self.skin)
        if fields is not None:
            refusal = camera_motion(fields, self.marks.pitch, self.marks.px_per_unit, places)
        if fields is None or refusal:
            fields, places = None, NOTHING
        reach = NONE if fields is None else reach_of(fields, places, self.marks, self.skin)
        damage = NONE if fields is None else self._damage(fields, places, points, reach)
        slip = self._slip.slips(places)
        readings = touch_readings(
            frame,
            self.marks,
            self.skin,
            self.lattice,
            len(points),
            fields,
            places,
            refusal,
            reach,
            slip,
            damage,
        )
        return ShearTouch(readings, points, fields, places, refusal.why, refusal.code)

    def _damage(
        self, fields: StrainFields, places: TouchPlaces, points: ControlPoints, reach: Refusal
    ) -> Refusal:
        """Why the skin looks torn; a contact outside the area moves marks as no model has it."""
        marks = self.marks
        torn = self._torn or damage_of(
            fields, places, marks.reference, points, marks.bare, marks.gap, marks.pitch, moved=not reach
        )
        return Refusal("skin_torn", f"the skin looks torn: {torn}") if torn else NONE

    def _seen(self, frame: Frame) -> tuple[ControlPoints, StrainFields | None, Refusal]:
        """Marks and strain of a frame, or why there are none."""
        tracked = self.marks.follow(frame.image)
        points = tracked.points
        refusal = Refusal("no_pattern", tracked.reason) if tracked.reason else NONE
        refusal = refusal or why_unreadable(look_at(frame.image, self._box), self._look)
        if not refusal and len(points) < MIN_SEEN * len(self.marks.reference):
            refusal = Refusal(
                "too_few_marks",
                f"{len(points)} of the reference's {len(self.marks.reference)} marks are seen, and at least "
                f"{100 * MIN_SEEN:.0f} % are needed",
            )
        if refusal:
            return points, None, refusal
        try:
            fields = self._meter.fields(points)
        except RangeError as refused:
            return points, None, Refusal("too_few_marks", str(refused))
        moved = camera_motion(fields, self.marks.pitch, self.marks.px_per_unit)
        return points, None if moved else fields, moved
