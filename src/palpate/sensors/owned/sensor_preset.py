"""A preset of a sensor: frames, the skin in them, settings of its camera and marks, each with its source.

Presets are TOML files, those of `presets` or one's own. Each table says where its values come from, by a
name among the file's sources, or that they are assumed. Lengths in a file are millimetres, and the skin's
region is a share of the frame, so that it holds at every size that the camera offers.
"""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from palpate.core import InputError, RangeError, new_file
from palpate.core.parsing import parser
from palpate.devices.file_fields import Part, read_toml, validated

PRESETS = "presets"
OWN = "own"

Positive = Annotated[float, Field(gt=0, lt=1e6)]
Share = Annotated[float, Field(ge=0, le=1)]
Text = Annotated[str, Field(max_length=400)]
UsbId = Annotated[str, Field(pattern=r"^[0-9a-f]{4}:[0-9a-f]{4}$")]


class SourcedPart(Part):
    """A table whose values have a source, or are said to be assumed.

    Attributes:
        source: name of one of the file's sources.
        assumed: whether nothing published says so.
        note: what else is to be known.
    """

    source: str | None = None
    assumed: bool = False
    note: Text = ""

    @model_validator(mode="after")
    def _says_where_from(self) -> SourcedPart:
        if (self.source is None) != self.assumed:
            raise ValueError('give one of source = "NAME" and assumed = true')
        return self


class PresetSource(Part):
    """Where values come from: a text, and its address or DOI where it has one."""

    what: Text
    url: Annotated[str, Field(pattern=r"^https://\S+$")] | None = None
    doi: Annotated[str, Field(pattern=r"^10\.\d{4,9}/\S+$")] | None = None

    @property
    def address(self) -> str:
        """The address that is cited."""
        return f"https://doi.org/{self.doi}" if self.doi else self.url or self.what


class FrameMode(SourcedPart):
    """A size of frames that the camera offers.

    Attributes:
        size_px: width and height [px].
        rates_hz: frames a second, the usual one first.
        format: four letters by which the camera names its coding; empty where not known.
    """

    size_px: tuple[Annotated[int, Field(ge=16, le=20000)], Annotated[int, Field(ge=16, le=20000)]]
    rates_hz: Annotated[tuple[Positive, ...], Field(min_length=1)]
    format: Annotated[str, Field(max_length=4)] = ""


class CameraAdvice(SourcedPart):
    """Settings of a camera under which its picture tells force and not light; None where not known.

    Attributes:
        auto_exposure, auto_white_balance, auto_focus: whether the camera sets them by itself.
        exposure_ms: [ms].
        white_balance_kelvin: colour temperature [K].
        gain: as the camera counts it.
    """

    auto_exposure: bool | None = None
    exposure_ms: Positive | None = None
    auto_white_balance: bool | None = None
    white_balance_kelvin: Annotated[float, Field(ge=1000, le=20000)] | None = None
    auto_focus: bool | None = None
    gain: Annotated[float, Field(ge=0)] | None = None


class OwnedCamera(SourcedPart):
    """How a sensor's camera is recognised, what it offers and how it is set.

    Attributes:
        names: words of the name that it tells over USB.
        usb: its vendor and product numbers, as `lsusb` writes them.
        modes: sizes and rates.
        settings: advice.
    """

    names: tuple[Annotated[str, Field(min_length=3, max_length=80)], ...] = ()
    usb: tuple[UsbId, ...] = ()
    modes: tuple[FrameMode, ...] = ()
    settings: CameraAdvice


class SkinInFrame(SourcedPart):
    """Where the skin lies in a frame, and how large it is.

    Attributes:
        region_share: left, top, width and height, as shares of the frame's width and height.
        region_mm: width and height of what that region shows [mm]; needed for millimetres.
        size_mm: width and height of the skin or gel itself [mm].
        dark_field: whether that region is dark without stress, as between crossed polarisers, and what lies
            beside it shows what comes near.
        see_through: whether the camera sees through the skin what hangs before it.
    """

    region_share: tuple[Share, Share, Share, Share] | None = None
    region_mm: tuple[Positive, Positive] | None = None
    size_mm: tuple[Positive, Positive] | None = None
    dark_field: bool = False
    see_through: bool = False

    @model_validator(mode="after")
    def _lies_in_the_frame(self) -> SkinInFrame:
        if self.region_share is not None:
            left, top, width, height = self.region_share
            if min(width, height) <= 0 or left + width > 1 + 1e-6 or top + height > 1 + 1e-6:
                raise ValueError(
                    f"region_share {list(self.region_share)}: left, top, width and height as shares of the "
                    "frame, width and height above 0, and all of it inside"
                )
        return self


class MarksInSkin(SourcedPart):
    """Pins or dots in the skin.

    Attributes:
        kind: "none"; "bright" or "dark" on their ground; or "any", to be looked for.
        count: how many, where known.
    """

    kind: Literal["none", "bright", "dark", "any"]
    count: Annotated[int, Field(ge=7, le=100000)] | None = None


class PresetFact(SourcedPart):
    """Something known of the sensor, in words."""

    what: Text
    value: Text


class SensorPreset(Part):
    """What is known of a sensor that people own.

    Attributes:
        name: by which it is asked for.
        title: how its makers call it.
        kind: what a press does to its picture: colours of a lit gel, shade of a dark one, pins, or other.
        about: one sentence.
        camera: how it is recognised and set.
        skin: its region and size.
        marks: pins or dots.
        facts: what else is known.
        sources: where values come from, by name.
    """

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]{0,39}$")]
    title: Text
    kind: Literal["lit gel", "dark gel", "pins", "other"]
    about: Text
    camera: OwnedCamera
    skin: SkinInFrame
    marks: MarksInSkin
    facts: tuple[PresetFact, ...] = ()
    sources: dict[str, PresetSource] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _has_its_sources(self) -> SensorPreset:
        parts = (self.camera, *self.camera.modes, self.camera.settings, self.skin, self.marks, *self.facts)
        missing = sorted({part.source for part in parts if part.source} - set(self.sources))
        if missing:
            raise ValueError(f"sources {missing} are named and not listed under [sources]")
        return self

    def region_px(self, size_px: tuple[int, int]) -> tuple[int, int, int, int]:
        """Region of the skin in a frame: x, y, width and height [px]; the whole frame where not known.

        Args:
            size_px: width and height of the frame [px].
        """
        if self.skin.region_share is None:
            return 0, 0, *size_px
        left, top, width, height = self.skin.region_share
        x, y = round(left * size_px[0]), round(top * size_px[1])
        return (
            x,
            y,
            min(round(width * size_px[0]), size_px[0] - x),
            min(round(height * size_px[1]), size_px[1] - y),
        )

    def mm_per_px(self, size_px: tuple[int, int]) -> float | None:
        """Length on the skin that a pixel of a frame shows [mm]; None where no scale is known.

        Args:
            size_px: width and height of the frame [px].
        """
        if self.skin.region_mm is None:
            return None
        _, _, width, height = self.region_px(size_px)
        across, down = self.skin.region_mm[0] / width, self.skin.region_mm[1] / height
        if abs(across - down) > MAX_NOT_SQUARE * across:
            raise RangeError(
                f"a frame of {size_px[0]} x {size_px[1]} px: its pixels would be {across:.4f} x {down:.4f} "
                f"mm on the skin of {self.name!r}, and they are square; give frames that are not squeezed"
            )
        return (across + down) / 2

    def recognises(self, name: str, usb: str = "") -> bool:
        """Whether a camera is of this sensor, by the name it tells or its USB numbers as "2833:0209"."""
        # Whole words: "DIGIT" is no part of "Digital Microscope".
        words = (rf"(?<![a-z0-9]){re.escape(part.lower())}(?![a-z0-9])" for part in self.camera.names)
        return any(re.search(word, name.lower()) for word in words) or usb.lower() in self.camera.usb


MAX_NOT_SQUARE = 0.03


def preset_names() -> tuple[str, ...]:
    """Names of the presets that palpate has."""
    return tuple(sorted(path.name.removesuffix(".toml") for path in _folder().iterdir()))


@cache
def sensor_preset(name: str) -> SensorPreset:
    """A preset that palpate has, by its name."""
    if name not in preset_names():
        raise InputError(
            f"there is no preset {name!r}; there are {', '.join(preset_names())}, and `palpate sensors new "
            "FILE` begins one of your own"
        )
    return _read(Path(str(_folder() / f"{name}.toml")))


def read_preset(name_or_path: str | Path) -> SensorPreset:
    """A preset by its name, or from a TOML file."""
    path = Path(name_or_path)
    return _read(path) if path.suffix == ".toml" else sensor_preset(str(name_or_path))


def recognised_preset(name: str, usb: str = "") -> SensorPreset | None:
    """The preset whose camera tells this name or these USB numbers; None where none does.

    Args:
        name: as the system lists the camera, e.g. "GelSight Mini R0B 2BNN-4ZE7".
        usb: vendor and product numbers, e.g. "0c45:636d"; empty where not known.
    """
    presets = (sensor_preset(one) for one in preset_names())
    return next((preset for preset in presets if preset.recognises(name, usb)), None)


def write_own_preset(path: Path) -> None:
    """Begin a file of one's own, with what each field means."""
    if path.suffix != ".toml":
        raise InputError(f"{path}: a preset is a TOML file; give a name that ends in .toml")
    text = (_folder() / f"{OWN}.toml").read_text(encoding="utf-8")
    name = "".join(c if c.isascii() and c.isalnum() else "-" for c in path.stem.lower()).strip("-") or OWN
    with new_file(path) as building:
        building.write_text(text.replace(f'name = "{OWN}"', f'name = "{name[:40]}"'), encoding="utf-8")


def _folder() -> Path:
    return Path(str(files("palpate.sensors.owned") / PRESETS))


@parser("sensor preset", InputError)
def _read(path: Path) -> SensorPreset:
    return validated(SensorPreset, path, read_toml(path))
