"""Verbs of softness rendered: objects that one cue cannot tell apart, and what a display can do of one."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from palpate.cli.display import rendering_verbs
from palpate.cli.verb_support import group, print_found, progress_bar

if TYPE_CHECKING:
    from palpate.mechanics.half_space.hertz import Body
    from palpate.softness import Rendered, SoftObject, StackedSpecimen
    from palpate.softness.rendering_simulation import Rendering

AGREES = 0.05  # deviation of c from 1, as in the wiring guide
HERTZ_RADIUS = 0.5  # of a ball, to which a contact is small

display_app = group("Render softness on a contact-area display and an arm.")

Finger = Annotated[
    str, Option(help="MODULUS_KPA:RADIUS_MM of the fingertip; 7 to 33 kPa and 15 mm are reported.")
]
Poisson = Annotated[float, Option(help="Poisson's ratio of objects and finger, 0 to 0.5.")]
Figure = Annotated[Path | None, Option(help="PNG to draw; must not exist.")]
Objects = Annotated[
    list[str],
    Argument(
        metavar="OBJECT...",
        help="MODULUS_KPA:RADIUS_MM of an object (a flat's radius is inf), then of the other; where that is "
        "to be found, its MODULUS_KPA alone.",
    ),
]
PairForce = Annotated[float, Option(help="Force at which both are compared [N].")]


def kinesthetic(
    words: Objects, finger: Finger, poisson: Poisson = 0.5, force_n: PairForce = 2.0, figure: Figure = None
) -> None:
    """Find the ball of another modulus that feels alike to the arm.

    Example: palpate pairs kinesthetic 1000:2.5 150 --finger 100:15
    """
    from palpate.mechanics.half_space.hertz import alike_to_the_arm

    _tell_partner("kinesthetic", alike_to_the_arm, words, finger, poisson, force_n, figure)


def cutaneous(
    words: Objects, finger: Finger, poisson: Poisson = 0.5, force_n: PairForce = 2.0, figure: Figure = None
) -> None:
    """Find the ball of another modulus that feels alike to the skin.

    Example: palpate pairs cutaneous 200:30 20 --finger 100:15
    """
    from palpate.mechanics.half_space.hertz import alike_to_the_skin

    _tell_partner("cutaneous", alike_to_the_skin, words, finger, poisson, force_n, figure)


def compare(
    words: Objects, finger: Finger, poisson: Poisson = 0.5, force_n: PairForce = 2.0, figure: Figure = None
) -> None:
    """Compute how far two objects differ to each cue under a finger.

    Example: palpate pairs compare 1000:2.5 150:7.32 --finger 20:15
    """
    one, other = _objects(words, 2, "two objects, each MODULUS_KPA:RADIUS_MM")
    bodies = [
        ball_of_words("object", one, poisson),
        ball_of_words("object", other, poisson),
        ball_of_words("--finger", finger, poisson),
    ]
    _tell(None, bodies, poisson, force_n, figure)


def _objects(words: list[str], count: int, what: str) -> list[str]:
    from palpate.core import InputError

    if len(words) != count:
        raise InputError(f"{len(words)} objects are given; give {what}")
    return words


def _tell_partner(
    cue: str,
    partner: Callable[[Body, Body, float], Body],
    words: list[str],
    finger: str,
    poisson: float,
    force_n: float,
    figure: Path | None,
) -> None:
    from palpate.core import InputError, RangeError

    one, other_kpa = _objects(words, 2, "MODULUS_KPA:RADIUS_MM of one and MODULUS_KPA of the other")
    try:
        other_modulus_kpa = float(other_kpa)
    except ValueError:
        raise InputError(
            f"modulus {other_kpa!r} of the other object is no number of kPa, as in 150"
        ) from None
    if not other_modulus_kpa > 0:
        raise RangeError(f"a modulus of {other_modulus_kpa:g} kPa for the other object; give one above 0 kPa")
    first, tip = ball_of_words("object", one, poisson), ball_of_words("--finger", finger, poisson)
    other = partner(first, tip, 1e3 * other_modulus_kpa / (1 - poisson**2))
    _tell(cue, [first, other, tip], poisson, force_n, figure)


def ball_of_words(what: str, text: str, poisson: float) -> Body:
    """An elastic ball of words such as 100:15, in kPa and mm."""
    from palpate.core import InputError, RangeError
    from palpate.mechanics.half_space.hertz import Body

    if not 0 <= poisson <= 0.5:
        raise RangeError(f"a Poisson's ratio of {poisson:g}; 0 to 0.5 are allowed")
    modulus, _, radius = text.partition(":")
    try:
        return Body(1e3 * float(modulus) / (1 - poisson**2), 1e-3 * float(radius))
    except RangeError:
        raise
    except ValueError:
        raise InputError(f"{what} {text!r} is not MODULUS_KPA:RADIUS_MM, as in 100:15") from None


def _tell(cue: str | None, bodies: list[Body], poisson: float, force_n: float, figure: Path | None) -> None:
    from palpate.core import RangeError

    if not 0 < force_n < float("inf"):
        raise RangeError(f"--force-n is {force_n:g} N; give a finite force above 0 N")
    one, other, finger = bodies
    pair = [body.against(finger) for body in (one, other)]
    ways, areas = (
        [float(both.approach_m(force_n)) for both in pair],
        [float(both.area_m2(force_n)) for both in pair],
    )
    radius = max(
        (A / math.pi) ** 0.5 / min(body.radius_m, finger.radius_m)
        for A, body in zip(areas, bodies, strict=False)
    )
    answer: dict[str, Any] = {
        "alike_to": cue,
        "other_radius_mm": 1e3 * other.radius_m,
        "force_N": force_n,
        "displacement_mm": [1e3 * d for d in ways],
        "area_mm2": [1e6 * A for A in areas],
        "force_ratio_at_equal_displacement": (ways[0] / ways[1]) ** 1.5,
        "force_ratio_at_equal_area": (areas[0] / areas[1]) ** 1.5,
        "contact_radius_over_ball_radius": radius,
        "in_hertz_range": radius <= HERTZ_RADIUS,
        "law": "Hertz: elastic balls, small strain; a rough model of a fingertip",
    }
    if figure is not None:
        from palpate.reports.softness_figures import write_pair_figure

        named = {
            f"{body.modulus_pa * (1 - poisson**2) / 1e3:.4g} kPa, {body.radius_m * 1e3:.4g} mm": body
            for body in (one, other)
        }
        write_pair_figure(named, finger, force_n, figure)
    _print_drawn(answer, figure)


def _print_drawn(answer: dict[str, Any], figure: Path | None) -> None:
    """Print an answer, with the picture that was drawn of it."""
    print_found(answer if figure is None else answer | {"figure": str(figure)})


def specimens(
    moduli_kpa: Annotated[
        str, Option(help="Five Young's moduli, with 0, 10, 20, 35 and 45 % of softener: E,E,E,E,E [kPa].")
    ],
    finger: Finger,
    kind: Annotated[str, Argument(help="CL1, CL2, CL3, or all.")] = "all",
    poisson: Annotated[float, Option(help="Poisson's ratio of the silicones, 0 to 0.5.")] = 0.499,
    finger_poisson: Annotated[float, Option(help="Poisson's ratio of the finger, 0 to 0.5.")] = 0.5,
    force_n: PairForce = 1.0,
    figure: Figure = None,
) -> None:
    """Compute what the report's silicone specimens show each cue.

    Cylinders of 7 mm, of one silicone (CL1), a plate on silicone (CL2), two silicones (CL3).

    Example: palpate pairs specimens --moduli-kpa 800,500,300,150,100 --finger 100:15
    """
    from palpate.core import InputError, refuse_existing
    from palpate.softness import SpecimenClass, specimen_object, specimens as stacks_of

    if kind not in ("all", *SpecimenClass):
        raise InputError(f"class {kind!r}; there are {', '.join(SpecimenClass)}, and all")
    refuse_existing(figure)
    tip = ball_of_words("--finger", finger, finger_poisson)
    moduli = _moduli(moduli_kpa)
    classes = list(SpecimenClass) if kind == "all" else [SpecimenClass(kind)]
    stacks = {one: stacks_of(one, moduli, poisson) for one in classes}
    felt = {one: [specimen_object(each, tip, force_n) for each in stacks[one]] for one in classes}
    answer: dict[str, Any] = {
        "force_N": force_n,
        "classes": {one.value: _class_record(stacks[one], felt[one]) for one in classes},
        "model": "small strain; layers bonded and without end sideways, a plate's silicone free at its side; "
        "finger a ball of Hertz; verified, no specimen was measured",
    }
    if figure is not None:
        from palpate.reports.softness_figures import write_specimen_figure

        write_specimen_figure({one.value: felt[one] for one in classes}, force_n, figure)
    _print_drawn(answer, figure)


def _moduli(text: str) -> list[float]:
    from palpate.core import InputError

    try:
        return [1e3 * float(one) for one in text.split(",")]
    except ValueError:
        raise InputError(f"--moduli-kpa {text!r} are no numbers, as in 800,500,300,150,100") from None


def _class_record(stacks: Sequence[StackedSpecimen], felt: Sequence[SoftObject]) -> dict[str, Any]:
    """Both cues of a class's specimens at the greatest force, and how far they are apart."""
    from palpate.softness import SpecimenClass, series_spread

    ways = [1e3 * float(one.displacement.x[-1]) for one in felt]
    areas = [1e6 * float(one.area.x[-1]) for one in felt]
    record: dict[str, Any] = {
        "specimens": [
            {"name": one.name, "displacement_mm": way, "area_mm2": area}
            for one, way, area in zip(felt, ways, areas, strict=True)
        ],
        "displacement_spread": max(ways) / min(ways) - 1,
        "area_spread": max(areas) / min(areas) - 1,
    }
    if stacks[0].kind == SpecimenClass.MIRRORED:
        record["series_spread"] = series_spread(stacks)
        record["mirrored"] = [
            {
                "names": [felt[i].name, felt[-1 - i].name],
                "displacement_ratio": ways[-1 - i] / ways[i],
                "area_ratio": areas[-1 - i] / areas[i],
            }
            for i in range(len(felt) // 2)
        ]
    return record


@display_app.command()
def envelope(
    object_: Annotated[Path, Option("--object", help="TOML file of the object's curves, with units.")],
    mode: Annotated[
        str, Option(help="CM1: both cues. CM3: the skin's alone, the arm takes the way back.")
    ] = "CM1",
    height_mm: Annotated[float, Option(help="Stroke of the display's tip, until it is flat [mm].")] = 10.0,
    radius_mm: Annotated[float, Option(help="Radius of its base [mm].")] = 6.5,
    rings: Annotated[int, Option(help="Rings of which it is made; 0 for the ideal cone.")] = 0,
    sleeve_n_mm: Annotated[float, Option(help="Stiffness of the sleeve over the rings [N/mm].")] = 0.0,
    pressure_kpa: Annotated[float, Option(help="Greatest gauge pressure [kPa].")] = 100.0,
    force_n: Annotated[float, Option(help="Greatest force on the finger [N].")] = 10.0,
    arm_mm: Annotated[float, Option(help="Travel of the arm, to either side [mm].")] = 15.0,
    figure: Figure = None,
) -> None:
    """Say which part of an object can be rendered.

    Example: palpate display envelope --object foam.toml --figure foam.png
    """
    from palpate.core import InputError
    from palpate.softness import ConeDisplay, DisplayBounds, Mode, RenderingLaw, read_object

    if mode not in (Mode.BOTH, Mode.CUTANEOUS):
        raise InputError(f"mode {mode!r}; CM1 and CM3 press the display, and CM2 has a plate in its place")
    law = RenderingLaw(
        read_object(object_),
        ConeDisplay(1e-3 * height_mm, 1e-3 * radius_mm, rings, 1e3 * sleeve_n_mm),
        DisplayBounds(1e3 * pressure_kpa, force_n, (-1e-3 * arm_mm, 1e-3 * arm_mm)),
        Mode(mode),
    )
    state = law.envelope()
    answer: dict[str, Any] = {
        "object": law.object.name,
        "source": law.object.source,
        "mode": mode,
        "rendered_share_of_way": float(state.rendered.mean()),
        "spans": _spans(state),
        "greatest_pressure_kPa": float(state.pressure_pa.max()) / 1e3,
        "greatest_force_N": float(state.force_n.max()),
        "onset_mm2": law.onset.area_m2 * 1e6,
        "model": "quasi-static: no gas, valve, friction or arm dynamics; verified against the law, no device",
    }
    if figure is not None:
        from palpate.reports.softness_figures import write_envelope_figure

        write_envelope_figure(law, figure)
    _print_drawn(answer, figure)


def _spans(state: Rendered) -> list[dict[str, Any]]:
    """Stretches of area with one verdict, as they come while the finger presses."""
    import numpy as np

    ends = np.flatnonzero(state.limit[1:] != state.limit[:-1])
    bounds = [0, *(ends + 1), len(state.limit)]
    return [
        {
            "from_mm2": float(1e6 * state.area_m2[low]) if low else 0.0,
            "to_mm2": float(1e6 * state.area_m2[high - 1]),
            "force_N": float(state.force_n[high - 1]),
            "limit": str(state.limit[low]) or None,
        }
        for low, high in itertools.pairwise(bounds)
    ]


@display_app.command()
def simulate(
    object_: Annotated[Path, Option("--object", help="TOML file of the object's curves, with units.")],
    mode: Annotated[str, Option(help="CM1: both cues. CM2: the arm's alone. CM3: the skin's alone.")] = "CM1",
    peak_n: Annotated[float, Option(help="Force that a slow press would come to [N].")] = 1.0,
    frequency_hz: Annotated[float, Option(help="Presses a second, 0.1 to 20 [Hz].")] = 1.0,
    servo: Annotated[
        str, Option(help="flow: knows valve and gas. pid: of the pressure's error alone.")
    ] = "flow",
    presses: Annotated[int, Option(help="How many, 2 or more; the first is not scored.", min=2)] = 3,
    seed: Annotated[int, Option(help="Of the sensors' noise.")] = 0,
    figure: Figure = None,
) -> None:
    """Press an object on a virtual display and arm.

    Says how well both cues were kept.

    Example: palpate display simulate --object foam.toml --mode CM1 --peak-n 2 --json
    """
    from palpate.core import InputError
    from palpate.softness import read_object
    from palpate.softness.control.servos import PidServo
    from palpate.softness.rendering_simulation import simulate as press

    kind = rendering_verbs.checked_press(mode, frequency_hz, 20, figure)
    if servo not in ("flow", "pid"):
        raise InputError(f"servo {servo!r}; there are flow and pid")
    soft = read_object(object_)
    rendering_verbs.check_peak(soft, peak_n)
    with progress_bar() as tell:
        felt = press(
            soft, kind, peak_n=peak_n, frequency_hz=frequency_hz, seed=seed, presses=presses,
            servo=PidServo() if servo == "pid" else None, progress=tell,
        )  # fmt: skip
    answer = _simulated(felt, servo)
    if figure is not None:
        from palpate.reports.softness_figures import write_tracking_figure

        write_tracking_figure(felt, figure)
    _print_drawn(answer, figure)


def _simulated(felt: Rendering, servo: str) -> dict[str, Any]:
    """What is said of a simulated rendering."""
    from palpate.softness import Mode

    mode, inside = felt.law.mode, felt.inside
    kept = {"area": felt.off_area_n(), "displacement": felt.off_displacement_n()}
    unkept = {Mode.KINESTHETIC: "area", Mode.CUTANEOUS: "displacement"}.get(mode)
    return {
        "object": felt.law.object.name,
        "mode": mode.value,
        "servo": servo,
        "frequency_Hz": felt.frequency_hz,
        "peak_N": felt.peak_n,
        "greatest_N": felt.largest_n,
        "inside_envelope_share": float(inside.sum() / felt.scored.sum()),
        **{
            f"force_{cue}_rms_of_peak": None if cue == unkept else {
                "all": felt.share(off), "inside_envelope": felt.share(off, inside) if inside.any() else None,
            }
            for cue, off in kept.items()
        },
        "greatest_pressure_kPa": float(felt.pressure_pa.max()) / 1e3,
        "greatest_surface_motion_mm": float(abs(felt.displacement_m).max()) * 1e3,
        "given_back_mJ": felt.given_back_j * 1e3,
        "model": "simulated: gas, valve, sleeve, arm and finger by equations; no device was measured",
    }  # fmt: skip


@display_app.command()
def bench_test(
    table: Annotated[Path | None, Option(help="CSV of the points; must not exist.")] = None,
    figure: Figure = None,
    seed: Annotated[int, Option(help="Of the sensors' noise.")] = 0,
) -> None:
    """Press a virtual display at several pressures, as a bench test.

    Its force is compared with P = p A(s) + k s.

    A lab's own display takes palpate.softness.display_bench_test.run_bench_test.

    Example: palpate display bench-test --figure bench.png --json
    """
    from palpate.core import refuse_existing
    from palpate.softness.display_bench_test import write_bench_table
    from palpate.softness.virtual.rendering_bench import virtual_bench_test

    for path in (table, figure):
        refuse_existing(path)
    with progress_bar() as tell:
        test = virtual_bench_test(seed=seed, progress=tell)
    fit = test.fit()
    answer: dict[str, Any] = {
        "points": len(test.points),
        "peak_N": test.peak_n,
        "law_rms_N": test.rms_n,
        "law_rms_of_peak": test.rms_n / test.peak_n,
        "scale": fit.scale,
        "scale_standard_error": fit.scale_error,
        "sleeve_N_per_m": fit.sleeve_n_m,
        "friction_N": fit.friction_n,
        "fit_rms_N": fit.rms_n,
        "scale_within_5_percent": abs(fit.scale - 1) <= AGREES,
        "model": "simulated: no device was measured",
    }
    if table is not None:
        write_bench_table(test, table)
        answer["table"] = str(table)
    if figure is not None:
        from palpate.reports.softness_figures import write_bench_test_figure

        write_bench_test_figure(test, figure)
    _print_drawn(answer, figure)


display_app.command("run")(rendering_verbs.run)
display_app.command("stop")(rendering_verbs.stop)
