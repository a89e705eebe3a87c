"""Verbs of patterned skins: read touch by marks, calibrate their normal force, weigh another pad."""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from palpate.cli.verb_support import as_json, print_record, progress_bar, reading_words, say
from palpate.core import Frame, InputError, Lens, new_folder, refuse_existing
from palpate.core.sensor import sensor as find_sensor
from palpate.estimators.unit_fit import GRAVITY_M_S2

if TYPE_CHECKING:
    from palpate.estimators.shear import ShearReader, TiledSkin
    from palpate.reports.shear_page import ShearPage
    from palpate.sensing.frame_readers import TouchedFrame


def shear(
    source: Annotated[Path, Argument(help="Image, folder of images, run, video or multi-page TIFF.")],
    reference: Annotated[Path, Option(help="Frame of the untouched skin; of several, the first is taken.")],
    sensor: Annotated[str, Option(help="Sensor whose skin it is, e.g. nusense or nusense:7.")] = "nusense",
    lens: Annotated[
        Path | None, Option(help="Lens file of the camera, in place of the sensor's own.")
    ] = None,
    skin: Annotated[
        Path | None, Option(help="TOML or JSON of a dotted skin, in place of the sensor's.")
    ] = None,
    calibration: Annotated[
        Path | None, Option("--with", help="Force calibration of this pad: adds newtons.")
    ] = None,
    fields: Annotated[Path | None, Option(help="Folder to make: strain fields of each frame as NPZ.")] = None,
    html: Annotated[Path | None, Option(help="Page with pictures to make; must not exist.")] = None,
) -> None:
    """Read touch on a patterned skin from how its marks have moved.

    Place, edge, contacts, rotation, shift and flags come without a calibration; newtons with one.

    Example: palpate read press.mp4 --reference untouched.png --sensor nusense --json
    """
    from palpate.calibration.shear import ShearCalibration
    from palpate.sensing.frame_readers import (
        ForceInTouch,
        first_frame,
        read_touches,
        write_fields,
    )
    from palpate.sensing.frame_sources import open_source

    for path in (fields, html):
        refuse_existing(path)
    untouched = first_frame(reference)
    reader = _reader(untouched, sensor, lens, skin)
    force = None if calibration is None else ForceInTouch(ShearCalibration.load(calibration), reader)
    with ExitStack() as stack:
        frames = stack.enter_context(open_source(source))
        folder = stack.enter_context(new_folder(fields)) if fields else None
        progress = stack.enter_context(progress_bar())
        page = _page(source, reader, untouched) if html else None
        for count, seen in enumerate(read_touches(frames, reader, force), 1):
            say(json.dumps(seen.to_dict(), allow_nan=False) if as_json() else _line(seen))
            if folder:
                write_fields(folder, seen)
            if page:
                page.take(seen.name, seen.frame, seen.touch, seen.reason)
            progress("frames", count, len(frames))
        if page and html:
            page.write(html)


def _page(source: Path, reader: ShearReader, untouched: Frame) -> ShearPage:
    from palpate.reports.shear_page import ShearPage

    return ShearPage(str(source), reader, untouched)


def _reader(reference: Frame, sensor: str, lens: Path | None, skin: Path | None) -> ShearReader:
    from palpate.estimators.lattice import read_skin
    from palpate.estimators.shear import ShearReader

    own = None if lens is None else Lens.read(lens)
    if skin is not None:
        return ShearReader(read_skin(skin), reference, own)
    tiled = _tiled(sensor)
    return ShearReader(tiled if own is None else replace(tiled, lens=own), reference)


def _tiled(name: str) -> TiledSkin:
    made = find_sensor(name)
    describe = getattr(made, "shear_skin", None)
    if describe is None:
        raise InputError(
            f"sensor {name!r} does not describe a patterned skin; nusense does, and another maker's dotted "
            "skin is described by a file: --skin skin.toml"
        )
    return describe()


def _line(seen: TouchedFrame) -> str:
    if seen.touch is None:
        return f"{seen.name}: {seen.reason}"
    return f"{seen.name}: {'; '.join(reading_words(seen.touch.readings))}"


N_PER_G = 1e-3 * GRAVITY_M_S2
NewFile = Annotated[Path, Option(help="Calibration to make, an .npz; must not exist.")]


def fit(
    runs: Annotated[list[Path], Argument(help="Runs of one pad, with force, presses and reference frames.")],
    out: NewFile,
    sensor: Annotated[str, Option(help="Sensor with the pattern; default: as the first run says.")] = "",
    law: Annotated[str, Option(help="any-tip, placed (one tip), or published (gamma alone).")] = "any-tip",
    hysteresis: Annotated[bool, Option("--hysteresis", help="Fit the skin's memory too.")] = False,
    coverage: Annotated[float, Option(help="Of the intervals.")] = 0.90,
    note: Annotated[str, Option(help="Free words to keep with it.")] = "",
) -> None:
    """Fit a calibration of normal force to runs.

    Errors and intervals are of presses that were held out.

    Example: palpate calibrate --method shear-force run --out pad.npz --hysteresis
    """
    from palpate.calibration.shear import calibrate_runs

    with progress_bar() as progress:
        record = calibrate_runs(
            runs, out, sensor=sensor, law=law, hysteresis=hysteresis,
            coverage=coverage, note=note, progress=progress,
        )  # fmt: skip
    print_record(record)


def weigh(
    loaded: Annotated[Path, Argument(help="This pad with the weight on it: folder of images, video or run.")],
    calibration: Annotated[Path, Option("--with", help="Calibration (.npz) of a pad of the same make.")],
    reference: Annotated[Path, Option(help="This pad at rest: the same.")],
    mass_g: Annotated[float, Option(help="Mass of the weight, within the calibrated range [g].")],
    out: NewFile,
    error_g: Annotated[float, Option(help="Standard error of the mass [g].")] = 0.0,
    lays: Annotated[int, Option(help="How often it was laid on, each time at another place.")] = 1,
) -> None:
    """Take a calibration to another copy by a known weight.

    An image tells no stiffness; one weight does.

    Example: palpate check-weight on --with pad.npz --reference rest --mass-g 500 --out copy.npz
    """
    from palpate.calibration.shear import weigh_copy
    from palpate.recordings.exchange.frame_sequences import open_sequence

    with open_sequence(reference) as rest, open_sequence(loaded) as on:
        record = weigh_copy(
            calibration, out, untouched=list(rest), loaded=list(on),
            weight_n=N_PER_G * mass_g, weight_error_n=N_PER_G * error_g, lays=lays,
        )  # fmt: skip
    print_record(record)
