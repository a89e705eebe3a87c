"""Verbs that draw what a virtual sensor would see."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palpate.cli.shared import Json, print_found, reports_errors

if TYPE_CHECKING:
    from palpate.sensors.palm.wear import Wear

app = typer.Typer(help="Draw what a virtual sensor would see.", no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def start() -> None:
    """Draw what a virtual sensor would see."""


@app.command()
@reports_errors
def palm(
    depth_mm: Annotated[
        float, typer.Option(help="How deep the probe is pressed [mm]; negative: how far it hangs above.")
    ],
    out: Annotated[Path, typer.Option(help="PNG to write; must not exist.")],
    x_mm: Annotated[float, typer.Option(help="Across the view, to the right [mm].")] = 0.0,
    y_mm: Annotated[float, typer.Option(help="Towards the camera [mm].")] = 0.0,
    indenter: Annotated[
        str,
        typer.Option(
            help="sphere:DIAMETER, punch:DIAMETER, edge:LENGTH, cylinder:DIAMETER:LENGTH or "
            "two-points:DIAMETER:APART [mm]; the last three may end in :TURN [deg]."
        ),
    ] = "sphere:10",
    lateral_n: Annotated[str, typer.Option(help="Lateral load along x and y, X,Y [N].")] = "0,0",
    preset: Annotated[
        str, typer.Option(help="palm, small, demo, debug, crops, solaris, sylgard-184 or casting-resin.")
    ] = "palm",
    exact: Annotated[bool, typer.Option("--exact", help="March every ray anew: slower.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of the camera's noise.")] = 0,
    presses: Annotated[
        float, typer.Option(help="How many presses the membrane has had: an assumed law of its wear.")
    ] = 0.0,
    haze: Annotated[
        float | None, typer.Option(help="Share of light a clouded surface scatters, 0 to 1.")
    ] = None,
    scratches: Annotated[int | None, typer.Option(help="Fine scratches in each view.")] = None,
    yellowing: Annotated[
        float, typer.Option(help="Absorbance of the yellowed membrane at 450 nm, along its diameter.")
    ] = 0.0,
    ambient: Annotated[
        float, typer.Option(help="Room light in the camera over the lamp's brightest, such as 0.02.")
    ] = 0.0,
    lamp_mired: Annotated[
        float, typer.Option(help="Lamp's colour: warmer by so many mired (1e6 K over its temperature).")
    ] = 0.0,
    probe_in_mirror: Annotated[
        bool, typer.Option(help="Show the probe's body in the mirror, or the membrane's dent alone.")
    ] = True,
    opaque_underside: Annotated[
        bool, typer.Option("--opaque-underside", help="A dark layer under the membrane: a blind mirror.")
    ] = False,
    json_: Json = False,
) -> None:
    """Press a probe into the virtual photoelastic palm and write the camera's frame.

    Example: palpate render palm --depth-mm 3 --x-mm 5 --y-mm -2 --out frame.png
    """
    import numpy as np

    from palpate.core.contact import Pose
    from palpate.core.errors import InputError
    from palpate.core.files import new_file
    from palpate.recordings import png
    from palpate.sensors import palm as palms

    spec = palms.preset(preset)
    probe = palms.parse_probe(indenter)
    try:
        lateral = tuple(float(part) for part in lateral_n.split(","))
    except ValueError:
        lateral = ()
    if len(lateral) != 2:
        raise InputError(f"--lateral-n {lateral_n!r} is not two numbers of newtons, X,Y")
    if probe.shape == "sphere" and not any(lateral):
        fitted = replace(spec, indenter_radius_m=probe.radius_m)
        spec = fitted if palms.has_table(fitted) else spec  # otherwise linear layers press it
    spec = replace(
        spec,
        wear=_wear(presses, haze, scratches, yellowing),
        ambient=ambient,
        lamp_mired=lamp_mired,
        probe_in_mirror=probe_in_mirror,
        opaque_underside=opaque_underside,
    )
    pose = Pose(x_mm * 1e-3, y_mm * 1e-3, depth_mm * 1e-3)
    contact = palms.press(spec, pose, probe, lateral)
    frame = palms.render(contact, spec, np.random.default_rng(seed), exact=exact)
    found: dict[str, Any] = palms.facts(contact, spec) | {"out": str(out)}
    with new_file(out) as path:
        path.write_bytes(png.encode(frame.image).tobytes())
    print_found(found, "\n".join(f"{name}: {_shown(value)}" for name, value in found.items()), json_)


def _wear(presses: float, haze: float | None, scratches: int | None, yellowing: float) -> Wear:
    """Of so many presses, save for what is asked for itself."""
    from palpate.sensors.palm.wear import worn

    wear = replace(worn(presses), yellowing=yellowing)
    wear = wear if haze is None else replace(wear, haze=haze)
    return wear if scratches is None else replace(wear, scratches=scratches)


def _shown(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
