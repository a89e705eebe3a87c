"""Verbs on the machine: its cameras, and what palpate needs of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from palpate.cli.verb_support import print_found

if TYPE_CHECKING:
    from palpate.rig.real.camera_listing import ListedCamera
    from palpate.sensors.owned import SensorPreset


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
