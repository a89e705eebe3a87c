"""Reader of live frames of a patterned skin: place, edge, shift and flags of a touch, perhaps newtons."""

from __future__ import annotations

from pathlib import Path

from palpate.calibration.shear import ShearCalibration
from palpate.core import CertificateError, Drift, Frame, Image, InputError, PathText, Readings
from palpate.core.sensor import sensor as sensor_of
from palpate.estimators.lattice import DottedSkin, read_skin
from palpate.estimators.shear import ShearReader, ShearTouch
from palpate.estimators.shear.skin_marks import TiledSkin
from palpate.sensing.frame_readers import ForceInTouch
from palpate.sensing.streaming.live_readers import NO_ZERO


class ShearFrameReader:
    """Reads touch on a patterned skin frame by frame, after a zero.

    Dropped frames do no harm: marks are followed from the last frame read; memory fades by frame times.

    Attributes:
        needs: Missing zero or the reason why the last frame could not be read; empty otherwise.
        seen: Reader and touch of the last frame; None before one.
    """

    differential = True

    def __init__(
        self, skin: TiledSkin | DottedSkin, calibration: ShearCalibration | None = None, name: str = "skin"
    ) -> None:
        self._skin, self._calibration = skin, calibration
        self._name = name
        self._reader: ShearReader | None = None
        self._force: ForceInTouch | None = None
        self.needs = NO_ZERO.why
        self.seen: tuple[ShearReader, ShearTouch] | None = None

    @property
    def id(self) -> str:
        """Id of the calibration, or the skin's name without one."""
        return f"shear of {self._name}" if self._calibration is None else self._calibration.id

    def zero(self, untouched: Image) -> Drift | None:
        """Take an image as that of the untouched skin; drift is of a calibrated pad's marks."""
        reader = ShearReader(self._skin, Frame(untouched))
        self._force = None if self._calibration is None else ForceInTouch(self._calibration, reader)
        self._reader, self.needs, self.seen = reader, "", None
        return None

    def read(self, frame: Frame) -> Readings:
        """Readings of a frame; none where there is no untouched image, or the frame is of another size."""
        if self._reader is None or frame.fault:
            return Readings({})
        try:
            touch = self._reader.touch(frame)
        except InputError as refusal:
            self.needs, self.seen = str(refusal), None
            return Readings({})
        self.needs, self.seen = "", (self._reader, touch)
        return (touch if self._force is None else self._force.added(touch, frame)).readings

    def drift_of(self, image: Image) -> Drift | None:
        """Nothing is known of it by the image alone."""

    def kind_of(self, image: Image) -> str:
        """No kinds of change are known."""
        return ""


def open_shear_reader(
    skin: str, calibration: PathText | None = None, *, reference: Image | None = None
) -> ShearFrameReader:
    """Open a reader of shear.

    Args:
        skin: Sensor with a patterned skin, such as "nusense:7", or a TOML or JSON file of a dotted skin.
        calibration: File of `palpate calibrate --method shear-force`; None for touch without newtons.
        reference: No-contact image; None to zero later.
    """
    force = None if calibration is None else _force_by_marks(Path(calibration))
    reader = ShearFrameReader(_skin(skin), force, skin)
    if reference is not None:
        reader.zero(reference)
    return reader


def _force_by_marks(path: Path) -> ShearCalibration:
    if path.is_dir():
        raise CertificateError(
            f"{path} is a folder, and no calibration of force by marks, which is one file (.npz): `palpate "
            "force fit` makes it; without a calibration a patterned skin is read for touch alone",
            code="not-a-force-calibration",
        )
    return ShearCalibration.load(path)


def _skin(name: str) -> TiledSkin | DottedSkin:
    if Path(name).suffix in (".toml", ".json"):
        return read_skin(Path(name))
    describe = getattr(sensor_of(name), "shear_skin", None)
    if describe is None:
        raise InputError(
            f"sensor {name!r} does not describe a patterned skin; nusense does, and a dotted skin is "
            "described by a file: give skin.toml"
        )
    skin: TiledSkin = describe()
    return skin
