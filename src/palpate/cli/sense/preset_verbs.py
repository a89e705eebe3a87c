"""Verbs of sensors that people own: what is known of each, with its source, and a file for one's own.

Verbs on the machine: its cameras, and what palpate needs of it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option, Typer

from palpate.cli.verb_support import Group, print_found, record_text, say

if TYPE_CHECKING:
    from palpate.rig.real.camera_listing import ListedCamera
    from palpate.sensors.owned import SensorPreset

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
        known = shown.model_dump(mode="json", exclude_none=True)
        print_found(shown.model_dump(mode="json"), record_text(known))
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
