"""Writes what `before.zip` holds: run once by the version whose files they are, never by a later one.

python tests/golden/write_before.py FOLDER, from the root of a checkout of that version (d58013a).
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, replace
from pathlib import Path
from zipfile import ZIP_LZMA, ZipFile

import numpy as np
from typer.testing import CliRunner

sys.path.insert(0, str(Path.cwd()))

from palpate.devices.operator import OperatorCommand
from tests.rig.rigs import CLOCK_NS, SPEC, plan, rig
from tests.virtual_presses import KAPPA_N_M, pressed, references

from palpate.calibration import Plan, calibrate, evaluate
from palpate.calibration.compliance import ReferenceTrial, calibrate_compliance
from palpate.calibration.compliance_reading import read_touch
from palpate.cli import app
from palpate.core.clock import ManualClock
from palpate.estimators import Estimator
from palpate.recordings.check import check
from palpate.rig import Control, record
from palpate.rig.plans import Listed
from palpate.sensors import palm
from palpate.sensors.tactip import tactip
from palpate.studies import Protocol, demo
from palpate.studies.tactip_trials import specimens_at

NAMES = ("rigid", "S1", "S3")


def certificate(folder: Path) -> None:
    """A run of five places, a certificate, and what it says of the same run."""
    palm.demo = lambda: replace(SPEC)
    run = demo.record(folder / "run", Protocol(presses=3), locations=5, seed=3)
    targets = ("x_mm", "depth_mm", "force_N")
    calibrate(run, Plan(targets, split="group:location", size_px=(12, 16)), folder / "cal")
    estimator = Estimator.open(folder / "cal", threads=1)
    whole = [
        {name: [one.value, one.low, one.high] for name, one in estimator.read(frame).items()}
        for frame in run.frames()
    ]
    (folder / "readings.json").write_text(json.dumps(whole))
    (folder / "scores.json").write_text(json.dumps(evaluate(estimator, run)))
    told = CliRunner().invoke(app, ["sense", str(folder / "cal"), str(folder / "run"), "--json"])
    (folder / "sense.jsonl").write_text(told.stdout)


def of_few_pins(trial: ReferenceTrial) -> ReferenceTrial:
    """Every sixth pin: noise in float64 is all that these files hold, and does not pack."""
    press = trial.press
    few = replace(press, untouched_px=press.untouched_px[::6], moved_px=press.moved_px[:, ::6])
    return replace(trial, press=few)


def compliance(folder: Path) -> None:
    """A calibration of the virtual TacTip, a press that it has not seen, and what it says of it."""
    spec = tactip()
    specimens = specimens_at(spec, KAPPA_N_M)
    known = references(spec, specimens, 2, 7000, rendered=False, names=NAMES)
    few = [replace(one, trials=tuple(of_few_pins(trial) for trial in one.trials)) for one in known]
    made = calibrate_compliance(few, note="virtual")
    made.save(folder / "tip.npz")
    trial = of_few_pins(*pressed(spec, specimens["new"][1], 1, 9000, rendered=False))
    names = ("frame", "force_n", "untouched_px", "moved_px", "position_m", "speed_m_s")
    arrays = {name: getattr(trial.press, name) for name in names}
    np.savez_compressed(folder / "press.npz", **arrays)
    told = {one.quantity: asdict(one) for one in read_touch(made, [trial.press], "new").readings}
    (folder / "touch.json").write_text(json.dumps(told))


def stopped_recording(folder: Path) -> None:
    """A recording that was stopped half way, and what `check` says of it."""
    control = Control()

    def stop_half_way(status) -> None:
        if status.shots >= 1:
            control.ask(OperatorCommand.STOP)

    one_place = plan(places=Listed(kind="listed", at_mm=((6.0, -4.0),)), depth_mm=0.4)
    record(
        rig(clock=ManualClock(CLOCK_NS)), one_place, folder / "stopped", control=control, watch=stop_half_way
    )
    told = check(folder / "stopped").to_dict()
    (folder / "check.json").write_text(json.dumps({k: v for k, v in told.items() if k != "path"}))


def zipped(folder: Path) -> None:
    """The folder as one file beside it."""
    with ZipFile(folder.with_suffix(".zip"), "w", ZIP_LZMA) as archive:
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            archive.write(path, path.relative_to(folder))


if __name__ == "__main__":
    at = Path(sys.argv[1])
    at.mkdir(parents=True, exist_ok=True)
    certificate(at)
    compliance(at)
    stopped_recording(at)
    zipped(at)
