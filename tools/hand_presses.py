"""What forty presses by hand are worth, on virtual sensors: error and coverage beside a whole rig recording.

    python tools/hand_presses.py collect --seeds 20   # presses of each hand: 40 to learn, 20 held out
    python tools/hand_presses.py score                # calibrate each hand, score on its held-out presses
    python tools/hand_presses.py rig                  # the same by a calibration of the sensor's short plan

A seed draws other places, forces, seatings, lamp gains and noise from the same laws, press by press: all
hands have the same habits, and days do not differ. So hands differ by chance alone, and their scatter is that
of drawn presses. The rig's calibration is scored on the very same held-out presses.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.fitting import calibrate
from palpate.core import ManualClock
from palpate.core.sensor import sensor
from palpate.estimators.certified import Estimator
from palpate.recordings import Run
from palpate.rig.engine import record
from palpate.rig.plans.plan_files import plan_of
from palpate.rig.virtual import virtual_rig
from palpate.rig.virtual.virtual_hand import HandHabits, VirtualHand
from palpate.sensing.collection import PressCollector, Weighing
from palpate.sensing.collection.press_collector import REST
from palpate.workflows.press_feeds import TRANSPORT_S, TRUTH_LABELS

LEARNT, HELD_OUT = 40, 20
RIG_PLAN = "palm-reduced"
FORCES_N = {"palm": (0.5, 11.0), "tactip": (0.3, 4.4), "nusense": (0.5, 9.6)}
"""Forces of the hands: within what the rig's plan reaches, so that neither is asked beyond what it learnt."""


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


def calibrated(run: Path, cal: Path, model: str) -> Estimator:
    """By a run, as the wizard trains."""
    if not cal.exists():
        calibrate(Run.open(run), CalibrationPlan(("force_N",), split="group:press", model=model), cal)
    return Estimator.open(cal)


def scores(estimator: Estimator, test: Run) -> dict[str, float]:
    """Error [N] and share of intervals that hold, of presses; what the untouched sensor is read as [N]."""
    labels = test.labels
    used = np.flatnonzero(~labels["reference"].astype(bool))
    read = [estimator.read(test.frame(int(i)))["force_N"] for i in used]
    value, low, high = np.array([(one.value, one.low, one.high) for one in read]).T
    true = labels["force_N"].to_numpy(float)[used]
    pressed = (labels["press"] != REST).to_numpy()[used]
    return {
        "mae": float(np.abs(value - true)[pressed].mean()),
        "coverage_90": float(((low <= true) & (true <= high))[pressed].mean()),
        "half_width": float((high - low)[pressed].mean() / 2),
        "untouched_n": float(value[~pressed].mean()) if (~pressed).any() else np.nan,
    }


def main() -> None:
    """Do one stage."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("stage", choices=("collect", "score", "rig"))
    parser.add_argument("--sensor", default="palm", choices=sorted(FORCES_N))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="seed of the first hand")
    parser.add_argument("--folder", type=Path, default=Path("hands"))
    parser.add_argument("--model", default="kernel-ridge")
    asked = parser.parse_args()
    folder, rows = asked.folder / asked.sensor, []
    folder.mkdir(parents=True, exist_ok=True)
    if asked.stage == "rig" and not (folder / "rig").exists():
        record(virtual_rig(asked.sensor, seed=1000), plan_of(RIG_PLAN, sensor(asked.sensor)), folder / "rig")
    for seed in range(asked.first, asked.first + asked.seeds):
        test = folder / f"hand{seed}-test"
        if asked.stage == "collect":
            if not test.exists():
                print(f"{collect(asked.sensor, seed, folder, f'hand{seed}'):.1f} s of one core", flush=True)
            continue
        learnt = "rig" if asked.stage == "rig" else f"hand{seed}-learn"
        estimator = calibrated(folder / learnt, folder / f"cal-{learnt}-{asked.model}", asked.model)
        rows.append(scores(estimator, Run.open(test)))
        print(seed, rows[-1], flush=True)
    if rows:
        print(
            f"{len(rows)} hands:",
            {key: round(float(np.nanmean([r[key] for r in rows])), 4) for key in rows[0]},
        )


if __name__ == "__main__":
    main()
