"""Preset of a sensor: frames, membrane, camera settings, and marks, each with its source.

Presets are TOML files. Each table names a source of the file, or is marked assumed. Lengths are millimetres;
the region is a fraction of the frame.
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
from palpate.devices.device_plugins import Part, read_toml, validated

PRESETS = "presets"
OWN = "own"

Positive = Annotated[float, Field(gt=0, lt=1e6)]
Share = Annotated[float, Field(ge=0, le=1)]
Text = Annotated[str, Field(max_length=400)]
UsbId = Annotated[str, Field(pattern=r"^[0-9a-f]{4}:[0-9a-f]{4}$")]


class SourcedPart(Part):
    """A table with a source, or marked assumed."""

    source: str | None = None
    assumed: bool = False
    note: Text = ""

    @model_validator(mode="after")
    def _says_where_from(self) -> SourcedPart:
        if (self.source is None) != self.assumed:
            raise ValueError('give one of source = "NAME" and assumed = true')
        return self


class PresetSource(Part):
    """Source: a text, and its address or DOI."""

    what: Text
    url: Annotated[str, Field(pattern=r"^https://\S+$")] | None = None
    doi: Annotated[str, Field(pattern=r"^10\.\d{4,9}/\S+$")] | None = None

    @property
    def address(self) -> str:
        return f"https://doi.org/{self.doi}" if self.doi else self.url or self.what


class FrameMode(SourcedPart):
    """Frame size and rates [Hz] of a camera, the usual rate first, with its FourCC format
    (empty if unknown).
    """

    size_px: tuple[Annotated[int, Field(ge=16, le=20000)], Annotated[int, Field(ge=16, le=20000)]]
    rates_hz: Annotated[tuple[Positive, ...], Field(min_length=1)]
    format: Annotated[str, Field(max_length=4)] = ""


class CameraAdvice(SourcedPart):
    """Camera settings under which the image depends on force and not on light; None if unknown."""

    auto_exposure: bool | None = None
    exposure_ms: Positive | None = None
    auto_white_balance: bool | None = None
    white_balance_kelvin: Annotated[float, Field(ge=1000, le=20000)] | None = None
    auto_focus: bool | None = None
    gain: Annotated[float, Field(ge=0)] | None = None


class OwnedCamera(SourcedPart):
    """A sensor's camera: USB names and IDs (as `lsusb` prints them), modes, and recommended settings."""

    names: tuple[Annotated[str, Field(min_length=3, max_length=80)], ...] = ()
    usb: tuple[UsbId, ...] = ()
    modes: tuple[FrameMode, ...] = ()
    settings: CameraAdvice


class SkinInFrame(SourcedPart):
    """Region of the membrane in a frame, and its size.

    Attributes:
        region_share: Left, top, width, and height as fractions of the frame.
        region_mm: Width and height of that region [mm]; required for millimetres.
        size_mm: Width and height of the membrane [mm].
        dark_field: Whether the region is dark without stress, as between crossed polarisers.
        see_through: Whether the camera sees objects through the membrane.
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
    """Pins or dots: none, bright or dark on their ground, or any, and their number if known."""

    kind: Literal["none", "bright", "dark", "any"]
    count: Annotated[int, Field(ge=7, le=100000)] | None = None


class PresetFact(SourcedPart):
    """A known property, in words."""

    what: Text
    value: Text


class SensorPreset(Part):
    """Preset of a sensor.

    Attributes:
        kind: Image type: colors of a lit gel, shade of a dark one, pins, or other.
        about: One sentence.
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
        """Region of the membrane for a frame size (x, y, width, height) [px]; the whole frame if unknown."""
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
        """Length per pixel for a frame size [mm]; None if unknown."""
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
        """Whether a camera is of this sensor, by name or USB ID as "2833:0209"."""
        # Whole words, so that "DIGIT" does not match "Digital Microscope".
        words = (rf"(?<![a-z0-9]){re.escape(part.lower())}(?![a-z0-9])" for part in self.camera.names)
        return any(re.search(word, name.lower()) for word in words) or usb.lower() in self.camera.usb


MAX_NOT_SQUARE = 0.03


def preset_names() -> tuple[str, ...]:
    """Return the names of the built-in presets."""
    return tuple(sorted(path.name.removesuffix(".toml") for path in _folder().iterdir()))


@cache
def sensor_preset(name: str) -> SensorPreset:
    """Return a built-in preset."""
    if name not in preset_names():
        raise InputError(
            f"there is no preset {name!r}; there are {', '.join(preset_names())}, and `palpate sensors new "
            "FILE` begins one of your own"
        )
    return _read(Path(str(_folder() / f"{name}.toml")))


def read_preset(name_or_path: str | Path) -> SensorPreset:
    """Return a preset by name, or from a TOML file."""
    path = Path(name_or_path)
    return _read(path) if path.suffix == ".toml" else sensor_preset(str(name_or_path))


def recognised_preset(name: str, usb: str = "") -> SensorPreset | None:
    """Return the preset whose camera has this name or USB ID; None if none does."""
    presets = (sensor_preset(one) for one in preset_names())
    return next((preset for preset in presets if preset.recognises(name, usb)), None)


def write_own_preset(path: Path) -> None:
    """Create a documented preset file."""
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
