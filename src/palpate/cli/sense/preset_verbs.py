"""Verbs of sensors that people own: what is known of each, with its source, and a file for one's own.

Verbs on the machine: its cameras, and what palpate needs of it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option, Typer

from palpate.cli.verb_support import Group, print_found, say

if TYPE_CHECKING:
    from palpate.rig.real.camera_listing import ListedCamera
    from palpate.sensors.owned import SensorPreset
    from palpate.sensors.owned.sensor_preset import SourcedPart

LIST = "list"


class ListedGroup(Group):
    """A group that lists where no verb is named."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take the verb that lists where no verb is named."""
        named = bool(args) and (args[0] in self.commands or args[0] == "--help")
        return super().parse_args(ctx, args if named else [LIST, *args])


app = Typer(
    cls=ListedGroup, add_completion=False, help="Sensors that people own: what is known of each, and whence.",
    rich_markup_mode=None,
)  # fmt: skip


@app.command(LIST)
def list_presets(
    sensor: Annotated[str, Argument(help="Name of a preset, or a TOML file of one; by default all.")] = "",
) -> None:
    """List sensors that people own, or say what is known of one.

    Each has frame sizes, the skin's region, settings of its camera and its marks, from published sources.

    Example: palpate sensors

    Example: palpate sensors digit
    """
    from palpate.sensors.owned import preset_names, read_preset, sensor_preset

    if sensor:
        shown = read_preset(sensor)
        print_found(shown.model_dump(mode="json"), _text(shown))
        return
    presets = [sensor_preset(name) for name in preset_names()]
    rows = [(preset.name, preset.title, preset.kind, _recognised_by(preset)) for preset in presets]
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    lines = ["  ".join([*(row[i].ljust(widths[i]) for i in range(3)), row[3]]).rstrip() for row in rows]
    told = "`palpate sensors NAME` says what is known of one, and from where"
    found = {"sensors": [preset.model_dump(mode="json") for preset in presets]}
    print_found(found, "\n".join([*lines, "", told]))


@app.command("new")
def new(file: Annotated[Path, Argument(help="TOML file to begin; must not exist.")]) -> None:
    """Begin a file for a sensor of your own, with what each field means.

    Example: palpate sensors new my-sensor.toml
    """
    from palpate.sensors.owned import write_own_preset

    write_own_preset(file)
    say(f"{file}: fill in what you know; `palpate sensors {file}` checks it")


def _recognised_by(preset: SensorPreset) -> str:
    names = [f'"{name}"' for name in preset.camera.names]
    return ", ".join([*names, *preset.camera.usb]) or "its camera is chosen by whoever builds it"


def _text(preset: SensorPreset) -> str:
    lines = [f"{preset.name}: {preset.title} ({preset.kind})", preset.about, ""]
    lines.append(_line("camera", _recognised_by(preset), preset.camera))
    for mode in preset.camera.modes:
        rates = ", ".join(f"{rate:g}" for rate in mode.rates_hz)
        size = f"{mode.size_px[0]} x {mode.size_px[1]} px at {rates} Hz {mode.format}".rstrip()
        lines.append(_line("frames", size, mode))
    lines.append(_line("settings", _settings(preset), preset.camera.settings))
    lines.append(_line("skin", _skin(preset), preset.skin))
    marks = preset.marks
    counted = "" if marks.count is None else f", {marks.count} of them"
    lines.append(_line("marks", f"{marks.kind}{counted}", marks))
    lines += [_line(fact.what, fact.value, fact) for fact in preset.facts]
    cited = [f"  [{name}] {source.what}: {source.address}" for name, source in preset.sources.items()]
    return "\n".join([*lines, *(["", "sources", *cited] if cited else [])])


def _line(what: str, value: str, part: SourcedPart) -> str:
    told = f"[{part.source}]" if part.source else "[assumed]"
    return "\n".join([f"{what}: {value} {told}", *([f"  {part.note}"] if part.note else [])])


SWITCHES = {"auto_exposure": "automatic exposure", "auto_white_balance": "automatic white balance",
            "auto_focus": "autofocus"}  # fmt: skip
AMOUNTS = {
    "exposure_ms": "exposure {:g} ms",
    "white_balance_kelvin": "white balance {:g} K",
    "gain": "gain {:g}",
}


def _settings(preset: SensorPreset) -> str:
    settings: dict[str, Any] = preset.camera.settings.model_dump()
    switches = [
        f"{what} {'on' if settings[name] else 'off'}"
        for name, what in SWITCHES.items()
        if settings[name] is not None
    ]
    amounts = [what.format(settings[name]) for name, what in AMOUNTS.items() if settings[name] is not None]
    return ", ".join([*switches, *amounts]) or "none are published"


def _skin(preset: SensorPreset) -> str:
    skin, told = preset.skin, []
    if skin.region_share is not None:
        told.append("region " + ", ".join(f"{100 * share:.1f} %" for share in skin.region_share))
    if skin.region_mm is not None:
        told.append(f"which shows {skin.region_mm[0]:.4g} x {skin.region_mm[1]:.4g} mm")
    if skin.size_mm is not None:
        told.append(f"gel {skin.size_mm[0]:g} x {skin.size_mm[1]:g} mm")
    return ", ".join(told) or "no region and no scale are published"


def cameras(
    all_: Annotated[bool, Option("--all", help="Tell every size and rate, and a udev rule.")] = False,
) -> None:
    """List the cameras of this machine: sizes, rates, users.

    Example: palpate cameras
    """
    from palpate.rig.real.camera_listing import how_listed, list_cameras

    found = list_cameras()
    text = "\n".join(_camera_text(one, all_) for one in found)
    nothing = how_listed() or "no camera is to be seen; begin without one: palpate live --camera virtual:palm"
    print_found([_camera_fields(one) for one in found], text or nothing)


def doctor() -> None:
    """Look this machine over, and say how what is missing is mended.

    Ends with status 1 where something that is needed is broken.

    Example: palpate doctor
    """
    from palpate.workflows.machine_check import check_machine, machine_text

    parts = check_machine()
    print_found([part.to_dict() for part in parts], machine_text(parts))
    if any(part.state == "broken" for part in parts):
        raise typer.Exit(1)


def _camera_fields(one: ListedCamera) -> dict[str, Any]:
    preset = _preset_of(one)
    return one.to_dict() | {"preset": None if preset is None else preset.name}


def _preset_of(one: ListedCamera) -> SensorPreset | None:
    from palpate.sensors.owned import recognised_preset

    return recognised_preset(one.name, one.usb_id)


def _camera_text(one: ListedCamera, everything: bool) -> str:
    preset = _preset_of(one)
    lines = [f"{one.path}  {one.name}"]
    lines.append(f"  palpate live --camera {one.serial or one.path}{_live_options(preset)}")
    if preset is not None:
        lines.append(f"  of a sensor that is known: palpate sensors {preset.name}")
    if not one.serial:
        lines.append("  it tells no serial number, so that its path may change when cables are swapped")
    best: dict[str, list[str]] = {}
    for mode in one.modes:
        rates = ", ".join(f"{rate:g}" for rate in (mode.rates_hz if everything else mode.rates_hz[:1]))
        at = f" at {rates} Hz" if rates else ""
        best.setdefault(mode.pixels, []).append(f"{mode.size_px[0]}x{mode.size_px[1]}{at}")
    for pixels, sizes in best.items():
        shown = sizes if everything else sizes[:4]
        more = f" and {len(sizes) - len(shown)} more" if len(sizes) > len(shown) else ""
        lines.append(f"  {pixels}: {'; '.join(shown)}{more}")
    if one.used_by:
        lines.append(f"  in use by {one.used_by}")
    if one.advice:
        lines.append(f"  -> {one.advice}")
    if one.udev and (everything or one.advice):
        lines.append(f"  udev rule, for a file in /etc/udev/rules.d: {one.udev}")
    return "\n".join(lines)


def _live_options(preset: SensorPreset | None) -> str:
    """Options that open a sensor's camera in its usual size, rate and exposure."""
    if preset is None or not preset.camera.modes:
        return ""
    mode, exposure_ms = preset.camera.modes[0], preset.camera.settings.exposure_ms
    exposure = "" if exposure_ms is None else f" --exposure-ms {exposure_ms:g}"
    return f" --size {mode.size_px[0]}x{mode.size_px[1]} --fps {mode.rates_hz[0]:g}{exposure}"
