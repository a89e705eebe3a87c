"""Verbs of the loop from touch to percept: what was touched is rendered to a finger, and what is lost."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from palpate.cli.display.softness_verbs import Finger, Poisson, ball_of_words
from palpate.cli.verb_support import print_found, progress_bar

if TYPE_CHECKING:
    from palpate.mechanics.fingertip_laws import Fingertip
    from palpate.softness.touched_flat import Cylinder
    from palpate.softness.transmission import CueNoise, Transmission


Weber = Annotated[
    str, Option(help="Weber fractions of an observer's cues, ARM:SKIN; assumed, give your participants' own.")
]
Frequency = Annotated[
    float,
    Option(min=0.2, max=2.2, help="Presses of the virtual finger, or up to 2.2 times slower or faster [Hz]."),
]
Peak = Annotated[float | None, Option(help="Force at the end of a press [N]; else the greatest for all.")]


def press(
    readings: Annotated[
        list[str], Argument(help="readings.json of `palpate read`, or NAME=PATH; more to compare.")
    ],
    finger: Finger,
    out: Annotated[Path, Option(help="Folder to make: transmission.html, summary.json, an object each.")],
    use: Annotated[str, Option(help="modulus, stiffness or stiffness_both_cues.")] = "modulus",
    cylinder: Annotated[
        str | None,
        Option(help="RADIUS_MM:HEIGHT_MM:POISSON:ENDS of the specimen, bonded or free, for a stiffness."),
    ] = None,
    true_kpa: Annotated[
        str | None, Option(help="True Young's moduli over 1 - nu^2 where they are known, E,E,… [kPa].")
    ] = None,
    finger_poisson: Poisson = 0.5,
    peak_n: Peak = None,
    frequency_hz: Frequency = 1.0,
    weber: Weber = "0.15:0.15",
    live_s: Annotated[
        float, Option(help="Also render the first object live on the virtual bench [s].")
    ] = 0.0,
) -> None:
    """Render what was touched to a finger, and say what each stage loses.

    Example: palpate transmit press S1/readings.json S2/readings.json --finger 20:15 --out felt
    """
    from palpate.core import InputError, RangeError, refuse_existing
    from palpate.mechanics.fingertip_laws import hertz_fingertip
    from palpate.softness.touched_flat import read_touched_flat
    from palpate.softness.transmission import MAX_LIVE_S, shared_peak_n, transmit

    refuse_existing(out)
    if not 0 <= live_s <= MAX_LIVE_S:
        raise RangeError(f"--live-s {live_s:g}: 0 for none, at most {MAX_LIVE_S:g} s")
    tip, noise = hertz_fingertip(ball_of_words("--finger", finger, finger_poisson)), _noise(weber)
    shape, named = _cylinder(cylinder), [_named(one) for one in readings]
    if len({name for name, _ in named}) < len(named):
        raise InputError("two readings of one name; write NAME=PATH to tell them apart")
    flats = {name: read_touched_flat(path, use, shape) for name, path in named}
    known = _known(true_kpa, len(flats))
    peak = shared_peak_n(tip, list(flats.values())) if peak_n is None else peak_n
    found = []
    with progress_bar() as progress:
        for i, (name, flat) in enumerate(flats.items()):
            found.append(
                transmit(
                    name,
                    flat,
                    tip,
                    peak_n=peak,
                    true_flat_pa=known[i],
                    frequency_hz=frequency_hz,
                    seed=100 * i,
                    progress=progress,
                )
            )
    _keep(out, found, tip, finger, noise, live_s=live_s)


def study(
    finger: Finger,
    out: Annotated[Path, Option(help="Folder to make: transmission.html of the first seed, summary.json.")],
    seeds: Annotated[int, Option(min=1, help="Virtual rigs, each with a calibration of its own.")] = 1,
    apart: Annotated[
        bool, Option("--apart", help="Nuisances drawn anew for each press, not once a session.")
    ] = False,
    finger_poisson: Poisson = 0.5,
    peak_n: Peak = None,
    frequency_hz: Frequency = 1.0,
    weber: Weber = "0.15:0.15",
) -> None:
    """Touch and render four virtual specimens on virtual rigs.

    Half a minute a seed.

    Example: palpate transmit study --finger 20:15 --seeds 1 --out loop
    """
    from palpate.core import refuse_existing
    from palpate.mechanics.fingertip_laws import hertz_fingertip
    from palpate.workflows.transmission_study import study_record, transmission_study

    refuse_existing(out)
    tip, noise = hertz_fingertip(ball_of_words("--finger", finger, finger_poisson)), _noise(weber)
    with progress_bar() as progress:
        found = transmission_study(
            tip,
            range(seeds),
            one_session=not apart,
            peak_n=peak_n,
            frequency_hz=frequency_hz,
            progress=progress,
        )
    first = list(found[0].transmissions.values())
    _keep(out, first, tip, finger, noise, study_=study_record(found, tip))


def _keep(
    out: Path, found: Sequence[Transmission], tip: Fingertip, finger: str, noise: CueNoise, *,
    live_s: float = 0.0, study_: dict[str, Any] | None = None,
) -> None:  # fmt: skip
    """Write page, numbers and objects; then say them."""
    import json

    from palpate.core import new_folder
    from palpate.reports.transmission_page import write_transmission_page
    from palpate.softness.transmission import felt_live, judged, object_file, transmissions_record

    judgements = judged(found, noise) if len(found) > 1 else {}
    words = f"{finger.replace(':', ' kPa, ')} mm"
    record = transmissions_record(found, judgements, noise, tip, words) | {"study": study_}
    if live_s:
        record["live"] = felt_live(found[0], live_s)
    with new_folder(out) as folder:
        write_transmission_page(folder / "transmission.html", found, judgements, record, tip)
        (folder / "summary.json").write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")
        for one in found:
            (folder / f"{one.name}.toml").write_text(object_file(one), encoding="utf-8")
    record["out"] = str(out)
    print_found(record)


def _noise(words: str) -> CueNoise:
    from palpate.core import InputError
    from palpate.softness.transmission import CueNoise

    arm, _, skin = words.partition(":")
    try:
        return CueNoise(float(arm), float(skin))
    except ValueError as e:
        if isinstance(e, InputError):
            raise
        raise InputError(f"--weber {words!r} is not ARM:SKIN, as in 0.15:0.15") from None


def _cylinder(words: str | None) -> Cylinder | None:
    from palpate.core import InputError
    from palpate.softness.touched_flat import Cylinder

    if words is None:
        return None
    parts = words.split(":")
    try:
        radius, height, poisson = (float(part) for part in parts[:3])
        (ends,) = parts[3:]
    except ValueError:
        raise InputError(
            f"--cylinder {words!r} is not RADIUS_MM:HEIGHT_MM:POISSON:ENDS, as in 20:40:0.48:free"
        ) from None
    return Cylinder(1e-3 * radius, 1e-3 * height, poisson, ends)  # type: ignore[arg-type]


def _named(words: str) -> tuple[str, Path]:
    from palpate.core import InputError
    from palpate.psychophysics import checked_code

    name, equals, path = words.partition("=")
    if equals:
        return checked_code(name, "object"), Path(path)
    found = Path(words)
    try:
        return checked_code(found.resolve().parent.name, "object"), found
    except InputError as e:
        raise InputError(f"{e}; or write NAME={words}") from e


def _known(words: str | None, count: int) -> list[float | None]:
    from palpate.core import InputError

    if words is None:
        return [None] * count
    try:
        values = [1e3 * float(one) for one in words.split(",")]
    except ValueError:
        raise InputError(f"--true-kpa {words!r} is no list of moduli, E,E,… [kPa]") from None
    if len(values) != count or not all(value > 0 for value in values):
        raise InputError(
            f"--true-kpa has {len(values)} values for {count} readings; one above 0 kPa for each"
        )
    return list(values)
