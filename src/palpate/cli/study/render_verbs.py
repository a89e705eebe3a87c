"""Verbs that draw what a virtual sensor would see."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

import palpate
from palpate.cli.verb_support import print_found, progress_bar

if TYPE_CHECKING:
    from palpate.recordings.exchange.press_folder import PressFolder
    from palpate.sensors.palm.membrane_faults import Wear


def palm(
    depth_mm: Annotated[
        float, Option(help="How deep the probe is pressed [mm]; negative: how far it hangs above.")
    ],
    out: Annotated[Path, Option(help="PNG to write; must not exist.")],
    x_mm: Annotated[float, Option(help="Across the view, to the right [mm].")] = 0.0,
    y_mm: Annotated[float, Option(help="Towards the camera [mm].")] = 0.0,
    indenter: Annotated[
        str,
        Option(
            help="sphere:DIAMETER, punch:DIAMETER, edge:LENGTH, cylinder:DIAMETER:LENGTH or "
            "two-points:DIAMETER:APART [mm]; the last three may end in :TURN [deg]."
        ),
    ] = "sphere:10",
    lateral_n: Annotated[str, Option(help="Lateral load along x and y, X,Y [N].")] = "0,0",
    preset: Annotated[
        str, Option(help="palm, small, demo, debug, crops, solaris, sylgard-184 or casting-resin.")
    ] = "palm",
    rim: Annotated[
        str, Option(help="What the membrane's free rim does to the ball's press: applied or stated.")
    ] = "stated",
    seed: Annotated[int, Option(min=0, help="Of the camera's noise.")] = 0,
    presses: Annotated[
        float, Option(help="How many presses the membrane has had: an assumed law of its wear.")
    ] = 0.0,
    haze: Annotated[float | None, Option(help="Share of light a clouded surface scatters, 0 to 1.")] = None,
    scratches: Annotated[int | None, Option(help="Fine scratches in each view.")] = None,
    yellowing: Annotated[
        float, Option(help="Absorbance of the yellowed membrane at 450 nm, along its diameter.")
    ] = 0.0,
    ambient: Annotated[
        float, Option(help="Room light in the camera over the lamp's brightest, such as 0.02.")
    ] = 0.0,
    lamp_mired: Annotated[
        float, Option(help="Lamp's colour: warmer by so many mired (1e6 K over its temperature).")
    ] = 0.0,
    probe_in_mirror: Annotated[
        bool, Option(help="Show the probe's body in the mirror, or the membrane's dent alone.")
    ] = True,
    opaque_underside: Annotated[
        bool, Option("--opaque-underside", help="A dark layer under the membrane: a blind mirror.")
    ] = False,
) -> None:
    """Press a probe into the virtual palm and write the frame.

    Example: palpate render palm --depth-mm 3 --x-mm 5 --y-mm -2 --out frame.png
    """
    import numpy as np

    from palpate.core.contact import Pose
    from palpate.core.errors import InputError
    from palpate.core.files import new_file
    from palpate.recordings.exchange import image_files
    from palpate.sensors import palm as palms

    sensor = palpate.sensor("palm" if preset == "palm" else f"palm-{preset}")
    spec, probe = sensor.spec, sensor.probe(indenter)
    try:
        lateral = tuple(float(part) for part in lateral_n.split(","))
    except ValueError:
        lateral = ()
    if len(lateral) != 2:
        raise InputError(f"--lateral-n {lateral_n!r} is not two numbers of newtons, X,Y")
    if probe.shape == "sphere":
        fitted = replace(spec, indenter_radius_m=probe.radius_m)
        spec = fitted if palms.has_table(fitted) else spec  # otherwise linear layers press it
    spec = replace(
        spec,
        rim=rim,
        wear=_wear(presses, haze, scratches, yellowing),
        ambient=ambient,
        lamp_mired=lamp_mired,
        probe_in_mirror=probe_in_mirror,
        opaque_underside=opaque_underside,
    )
    pose = Pose(x_mm * 1e-3, y_mm * 1e-3, depth_mm * 1e-3)
    contact = palms.press(spec, pose, probe, lateral)
    frame = palms.render(contact, spec, np.random.default_rng(seed))
    result: dict[str, Any] = palms.contact_summary(contact, spec) | {"out": str(out)}
    with new_file(out) as path:
        path.write_bytes(image_files.encode(frame.image).tobytes())
    print_found(result)


def tactip(
    out: Annotated[Path, Argument(help="Folder to make; must not exist.")],
    specimen: Annotated[
        list[str] | None,
        Option(
            help="NAME=STIFFNESS [N/mm] of a cylinder 40 mm high and wide. Or NAME=sphere:R_mm=20,E_MPa=0.3 "
            "(the same with a cap of a sphere on top, rigid without E_MPa), NAME=layer:h_mm=2,E_MPa=0.1 "
            "(bonded to a rigid base), NAME=viscous:E_MPa=0.1,E1_MPa=0.05,tau1_s=1 (a cylinder; E(t) = E + "
            "sum E_i exp(-t/tau_i)); E_MPa is Young's modulus. Again for more."
        ),
    ] = None,
    rigid: Annotated[bool, Option("--rigid", help="Press a rigid plate as well.")] = False,
    unknown: Annotated[
        list[str] | None, Option(help="Name whose stiffness specimens.csv shall not tell; again for more.")
    ] = None,
    tilt_deg: Annotated[
        float,
        Option(
            help="Of the specimens' tops, 0 to 50 [deg]. 0 is solved at finite strain without friction; "
            "others by linear bodies, or at finite strain too where there is a table of all that is pressed."
        ),
    ] = 0.0,
    friction: Annotated[
        float | None,
        Option(
            help="Coulomb's, on inclined tops. Left out: none where tables hold all that is pressed, else "
            "0.5. 0 is refused where they hold a part of it."
        ),
    ] = None,
    trials: Annotated[int, Option(min=1, max=999, help="Of each specimen.")] = 5,
    preset: Annotated[
        str, Option(help="127 or 331 pins; 331-fitted: lever and camera as fitted to taps of a real tip.")
    ] = "127",
    tip: Annotated[str, Option(help="base, even, soft-skin or stiff-skin.")] = "base",
    speed_mm_s: Annotated[float, Option(min=0.1, max=20, help="Of the tip's way down [mm/s].")] = 5.0,
    rig: Annotated[
        str,
        Option(
            help="ideal: the tip is where it is asked to be. linear: driven as in the compliance report, it "
            "lags and droops; actual_mm is its 12-bit encoder's, desired_mm what was asked for."
        ),
    ] = "ideal",
    seed: Annotated[int, Option(min=0, help="Of seating and noise.")] = 0,
    runs: Annotated[bool, Option("--runs", help="Also write each press as a run.")] = False,
    back: Annotated[bool, Option("--back", help="Also record the way back up.")] = False,
    late_ms: Annotated[float, Option(help="By which frames show earlier moments than they say [ms].")] = 0.0,
    hold_s: Annotated[
        float, Option(help="Stand still at the depth of the greatest force for, 0 to 60 [s].")
    ] = 0.0,
) -> None:
    """Press the virtual TacTip on soft specimens, as a rig records it.

    Without --specimen and --rigid the compliance report's five are pressed: rigid, S1 of 7.6 N/mm, S2 of 3.1,
    S3 of 1.1 and new of 5.3, which specimens.csv does not tell. Each press is a TIFF of frames and a table of
    force beside it.

    Example: palpate render tactip presses --specimen S1=7.6 --specimen S2=3.1 --trials 3
    """
    from palpate.core.files import refuse_existing
    from palpate.rig.virtual.linear_rig import rig_named
    from palpate.sensors.tactip.tactip_sensor import TacTip
    from palpate.workflows.tactip_trials import (
        REPORT_N_M,
        UNKNOWN,
        at_finite_strain,
        record_trials,
        specimens_at,
    )

    refuse_existing(out)  # before solving for minutes
    drive = rig_named(rig)
    own = _bodies(specimen or [], rigid)
    bodies, hidden = own or REPORT_N_M, unknown or ([] if own else list(UNKNOWN))
    spec = replace(palpate.sensor(f"tactip-{preset}").spec, tip=tip, speed_m_s=1e-3 * speed_mm_s)
    if friction is None:
        spec = at_finite_strain(spec, bodies.values(), math.radians(tilt_deg))
    else:
        spec = replace(spec, friction=friction)
    with progress_bar() as progress:
        pressed = specimens_at(spec, bodies, math.radians(tilt_deg), progress=progress)
        folder = record_trials(
            out, spec, pressed, trials, seed=seed, unknown=hidden, runs=runs, back=back,
            late_s=1e-3 * late_ms, hold_s=hold_s, rig=drive, progress=progress,
        )  # fmt: skip
    laws = {name: TacTip(spec).on(words).law for name, words in pressed.items()}
    print_found(_trials_record(folder, bodies, tilt_deg, runs, laws))


def _bodies(pairs: list[str], rigid: bool) -> dict[str, float | str]:
    """Specimens from ``NAME=STIFFNESS`` [N/m], or kind and numbers of ``NAME=KIND:NUMBERS``."""
    from palpate.core import WORDS_OF_SPECIMENS, InputError

    bodies: dict[str, float | str] = {"rigid": float("inf")} if rigid else {}
    for pair in pairs:
        name, _, value = pair.partition("=")
        if name in bodies:
            raise InputError(f"specimen {name!r} is given twice; a name stands for one specimen")
        if ":" in value:
            bodies[name] = value
            continue
        try:
            bodies[name] = 1e3 * float(value)
        except ValueError:
            raise InputError(
                f"--specimen {pair!r} is not NAME=STIFFNESS in N/mm, as in S1=7.6, nor another of: "
                f"{WORDS_OF_SPECIMENS}"
            ) from None
    return bodies


def _trials_record(
    folder: PressFolder,
    bodies: Mapping[str, float | str],
    tilt_deg: float,
    runs: bool,
    laws: Mapping[str, str],
) -> dict[str, Any]:
    from palpate.workflows.tactip_trials import stiffness_shown

    presses = sum(len(one.presses) for one in folder.specimens)
    shown = {name: stiffness_shown(k) for name, k in bodies.items() if not isinstance(k, str)}
    shaped = {name: k for name, k in bodies.items() if isinstance(k, str)}
    result = {
        "out": str(folder.path),
        "virtual": True,
        "presses": presses,
        "runs": presses if runs else 0,
        "tilt_deg": tilt_deg,
        "stiffness_N_per_mm": shown,
        "model": dict(laws),
    }
    return result | ({"shaped": shaped} if shaped else {})


def _wear(presses: float, haze: float | None, scratches: int | None, yellowing: float) -> Wear:
    """Wear after so many presses, save for what is asked for itself."""
    from palpate.sensors.palm.membrane_faults import worn

    wear = replace(worn(presses), yellowing=yellowing)
    wear = wear if haze is None else replace(wear, haze=haze)
    return wear if scratches is None else replace(wear, scratches=scratches)
