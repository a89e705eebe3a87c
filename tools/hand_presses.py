"""What forty presses by hand are worth, on virtual sensors: error and coverage beside a whole rig recording.

    python tools/hand_presses.py collect --seeds 20   # presses of each hand: 40 to learn, 20 held out
    python tools/hand_presses.py rig                  # the sensor's short plan on a virtual rig
    python tools/hand_presses.py cover                # fits and intervals alone, of every hand
    python tools/hand_presses.py score [--rig]        # calibrate each, score on the held-out presses

A seed draws other places, forces, seatings, lamp gains and noise from the same laws, press by press: all
hands have the same habits, and days do not differ. So hands differ by chance alone, and their scatter is that
of drawn presses. The rig's calibration is scored on the very same held-out presses.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.calibration.calibration_job import CalibrationJob, preparation_of, table_to_learn
from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.coverage.conformal import fit_intervals
from palpate.calibration.evaluation import evaluate
from palpate.calibration.fitting import calibrate
from palpate.core import ManualClock
from palpate.core.sensor import sensor
from palpate.estimators.certified import Estimator
from palpate.estimators.networks import make_model
from palpate.estimators.networks.model_interface import predict_rows
from palpate.recordings import PackedSet, Run, pack, split
from palpate.rig.engine import record
from palpate.rig.plans.plan_files import plan_of
from palpate.rig.virtual import virtual_rig
from palpate.rig.virtual.virtual_hand import HandHabits, VirtualHand
from palpate.sensing.collection import PressCollector, Weighing
from palpate.sensing.collection.press_collector import REST
from palpate.workflows.press_feeds import TRANSPORT_S, TRUTH_LABELS

LEARNT, HELD_OUT = 40, 20
RIG_PLAN = {"palm": "palm-reduced"}
FORCES_N = {"palm": (0.5, 11.0), "tactip": (0.3, 4.4), "nusense": (0.5, 9.6)}
"""Forces of the hands: within what the rig's plan reaches, so that neither is asked beyond what it learnt."""
AHEAD_S = 0.5  # of a press, from when frames of the untouched sensor are taken


def collect(name: str, seed: int, out: Path, label: str) -> float:
    """Collect presses of one hand into runs; frames are drawn only where they may be kept. Seconds taken."""
    begun = time.process_time()
    clock = ManualClock()
    hand = VirtualHand(name, seed=seed, clock=clock, habits=HandHabits(force_n=FORCES_N[name]))
    region = hand.design.regions()[hand.design.axes.region]
    for part, count in (("learn", LEARNT), ("test", HELD_OUT)):
        collector = PressCollector(
            out / f"{label}-{part}", hand.design.name, Weighing.by(hand.force), asked=count, region=region,
            frame_late_s=TRANSPORT_S, truth=hand.truth, truths=TRUTH_LABELS,
            clock=clock, regions=dict(hand.design.regions()), session=f"hand {seed}",
        )  # fmt: skip
        with collector:
            while len(collector.presses) < count:
                now_s = clock.now_ns() / 1e9
                last = hand.world.presses[-1] if hand.world.presses else None
                wanted = last is None or now_s < last.touches_s or last.holds_s[0] < now_s < last.holds_s[1]
                if wanted:
                    at_ns, frame = hand.camera.grab()
                    collector.on_frame(replace(frame, arrived_ns=at_ns))
                clock.sleep(0.05)
                collector.on_force(hand.force.drain())
        print(f"{label}-{part}: {collector.coverage.text}, {collector.status['refused']} refused", flush=True)
    return time.process_time() - begun


def record_rig(name: str, out: Path) -> None:
    """The sensor's short plan on a virtual rig."""
    rig = virtual_rig(name, seed=1000)
    record(rig, plan_of(RIG_PLAN[name], sensor(name)), out)


def plan_for(run: Run, **fields: object) -> CalibrationPlan:
    """As the wizard trains."""
    return CalibrationPlan(**({"targets": ("force_N",), "split": "group:press"} | fields))  # type: ignore[arg-type]


def score(
    folder: Path, label: str, plan: CalibrationPlan, tests: list[str], tag: str
) -> list[dict[str, object]]:
    """Calibrate on a run and score on others."""
    run, cal = Run.open(folder / label), folder / f"cal-{label}-{tag}"
    begun = time.process_time()
    if not cal.exists():
        calibrate(run, plan, cal)
    rows: list[dict[str, object]] = []
    seconds = time.process_time() - begun
    estimator = Estimator.open(cal)
    for test in tests:
        found = evaluate(estimator, Run.open(folder / test))["targets"]["force_N"]
        rows.append({"learnt": label, "test": test, "tag": tag, "cpu_s": seconds} | {
            key: found[key] for key in ("n", "mae", "rmse", "bias", "coverage_90") if key in found
        })  # fmt: skip
        print(json.dumps(rows[-1]), flush=True)
    return rows


def _kept(press: np.ndarray, frames: int) -> np.ndarray:
    """Rows of so many frames of each press, equally spaced."""
    rows = []
    for name in np.unique(press):
        of = np.flatnonzero(press == name)
        rows.append(of[np.unique(np.linspace(0, len(of) - 1, frames).round().astype(int))])
    return np.sort(np.concatenate(rows))


def cover(folder: Path, seed: int, plan: CalibrationPlan, frames: int) -> dict[str, float]:
    """Fits and intervals as the certificate makes them, without its audits; scores on held-out presses."""
    begun, run, test = (
        time.process_time(),
        Run.open(folder / f"hand{seed}-learn"),
        Run.open(folder / f"hand{seed}-test"),
    )
    with tempfile.TemporaryDirectory() as work:
        prepare, sets = preparation_of(run, plan), []
        for name, one in (("learn", run), ("test", test)):
            pack(one, Path(work) / name, prepare)
            packed = PackedSet.open(Path(work) / name)
            parts = split(table_to_learn(one.labels, plan), "group:press", folds=2)
            sets.append(CalibrationJob.of(one, plan, parts, packed).data)
        learn, held = sets
        pressed = (table_to_learn(test.labels, plan)["press"] != REST).to_numpy()
        parts = split(table_to_learn(run.labels, plan), "group:press", folds=plan.folds or 5, seed=plan.seed)
        kept = _kept(learn.groups, frames)
        model = make_model(plan.model, plan.options)
        outputs = np.empty_like(learn.values)
        for k, rows in enumerate(parts.folds):
            fitted = model.fit(learn, np.intersect1d(parts.training_rows(k), kept), seed=plan.seed)
            outputs[rows] = predict_rows(fitted, learn, rows)
        fitted = model.fit(learn, kept, seed=plan.seed)
        told = predict_rows(fitted, held, np.arange(len(held.values)))
    intervals = fit_intervals(outputs[kept], learn.values[kept], learn.groups[kept], plan.coverage)
    low, high = intervals.ends(told)
    return {
        "seed": seed,
        "mae": float(np.abs(told - held.values)[pressed].mean()),
        "untouched_n": float(told[~pressed].mean()) if (~pressed).any() else math.nan,
        "held_out_mae": float(np.abs(outputs - learn.values)[kept].mean()),
        "coverage_90": float(intervals.hold(told, held.values)[pressed].mean()),
        "half_width": float((high - low).mean() / 2),
        "cpu_s": time.process_time() - begun,
    }


def rig_error(estimator: Estimator, test: Run) -> float:
    """Mean absolute error of a calibration on the held-out presses of a hand [N]."""
    labels = test.labels
    rows = np.flatnonzero(~labels["reference"].astype(bool) & (labels["press"] != REST))
    read = [estimator.read(test.frame(int(i)))["force_N"].value for i in rows]
    return float(np.abs(np.array(read) - labels["force_N"].to_numpy(float)[rows]).mean())


def main() -> None:
    """Do one stage."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stage", choices=("collect", "rig", "score", "cover"))
    parser.add_argument("--first", type=int, default=0, help="seed of the first hand")
    parser.add_argument("--sensor", default="palm")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--folder", type=Path, default=Path("hands"))
    parser.add_argument("--model", default="kernel-ridge")
    parser.add_argument("--tag", default="as-wizard")
    parser.add_argument("--field", action="append", default=[], help="NAME=JSON of the calibration's plan")
    parser.add_argument("--frames", type=int, default=8, help="of each press that are learnt from")
    parser.add_argument("--folds", type=int, default=None)
    parser.add_argument("--rig", action="store_true", help="score the rig's calibration instead")
    asked = parser.parse_args()
    folder, name = asked.folder / asked.sensor, asked.sensor
    folder.mkdir(parents=True, exist_ok=True)
    if asked.stage == "collect":
        for seed in range(asked.first, asked.first + asked.seeds):
            if not (folder / f"hand{seed}-test").exists():
                print(f"{collect(name, seed, folder, f'hand{seed}'):.1f} s of one core", flush=True)
    elif asked.stage == "rig":
        record_rig(name, folder / "rig")
    elif asked.stage == "cover":
        rows = []
        for seed in range(asked.first, asked.first + asked.seeds):
            if (folder / f"hand{seed}-test").exists():
                plan = CalibrationPlan(
                    ("force_N",), model=asked.model, split="group:press", channels=3, folds=asked.folds
                )
                rows.append(cover(folder, seed, plan, asked.frames))
                print(json.dumps(rows[-1]), flush=True)
        told = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
        print(f"{len(rows)} seeds: {told}")
    else:
        fields = {key: json.loads(value) for key, _, value in (one.partition("=") for one in asked.field)}
        tuples = {key: tuple(v) if isinstance(v, list) else v for key, v in fields.items()}
        rows = []
        seeds = range(asked.first, asked.first + asked.seeds)
        if asked.rig:
            run, cal = Run.open(folder / "rig"), folder / f"cal-rig-{asked.tag}"
            if not cal.exists():
                calibrate(run, plan_for(run, model=asked.model, **tuples), cal)
            estimator = Estimator.open(cal)
            for s in seeds:
                error = rig_error(estimator, Run.open(folder / f"hand{s}-test"))
                rows.append({"test": f"hand{s}-test", "mae": error, "coverage_90": math.nan})
                print(json.dumps(rows[-1]), flush=True)
        else:
            for s in seeds:
                run = Run.open(folder / f"hand{s}-learn")
                rows += score(
                    folder,
                    f"hand{s}-learn",
                    plan_for(run, model=asked.model, **tuples),
                    [f"hand{s}-test"],
                    asked.tag,
                )
        print(
            f"{asked.tag}: MAE {np.mean([r['mae'] for r in rows]):.4f} N, coverage of 90 % intervals "
            f"{np.mean([r['coverage_90'] for r in rows]):.4f} over {len(rows)} seeds"
        )


if __name__ == "__main__":
    main()
