"""The verbs of normal force for patterned skins: calibrate on runs, and weigh another copy of the pad."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from palpate.cli.verb_support import print_record, progress_bar
from palpate.estimators.unit_fit import GRAVITY_M_S2

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
