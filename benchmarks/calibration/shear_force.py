"""Normal force of the virtual NUSense: error, coverage and copies, as the how-to prints them.

Marks are the true ones with noise of 0.05 px, which rendered frames are compared with first.

    python benchmarks/calibration/shear_force.py [PRESSES]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.virtual_shears import PLACES_M, VirtualPad, cycles, levels, slow_presses

from palpate.calibration.shear import CueMeter, ShearCalibration, calibrate_shear
from palpate.calibration.shear.calibrate_runs import baseline_errors, view_of_sensor
from palpate.calibration.shear.force_law import follow_memory
from palpate.calibration.shear.shear_calibration import usable
from palpate.estimators.lattice import MarkTracker

PAD = VirtualPad()
SPEC = PAD.sensor.spec
TIPS = ("round", "flat")
LOW_N, HIGH_N = 1.0, 8.0


def fitted(samples, law="any-tip", **words) -> ShearCalibration:
    return calibrate_shear(samples, PAD.reference, SPEC.lens, SPEC.camera_m, law=law, **words)


def scored(calibration, samples, memory=None):
    """Errors, whether intervals hold, and truths of valid readings within 1 to 8 N."""
    rows = memory if memory is not None else [None] * len(samples.cues)
    found = []
    for cues, force, row in zip(samples.cues, samples.force_n, rows, strict=True):
        reading = calibration.read(cues, row)
        if reading.valid and LOW_N <= force <= HIGH_N:
            found.append((reading.value - force, reading.contains(force), force))
    return np.array(found)


def say(what, found):
    off, held, _ = found.T
    print(f"{what}: {np.abs(off).mean():.3f} N (95 % {np.quantile(np.abs(off), 0.95):.2f}), "
          f"holds {100 * held.mean():.1f} % of {len(off)}", flush=True)  # fmt: skip


def rendered(count=100):
    """Ratio of cues of rendered frames to those of true marks with noise."""
    rng, view, meter = np.random.default_rng(1), view_of_sensor("nusense"), PAD.meter()
    tracker = MarkTracker(PAD.sensor.render(PAD.contact("round", 0, 0, 0.0), rng).image, view.pitch_px)
    own = CueMeter(tracker.reference.points, SPEC.lens, SPEC.camera_m)
    rows, lost = [], 0
    for i in range(count):
        tip = TIPS[i % 2]
        x, y = rng.uniform(-1, 1, 2) * PLACES_M
        contact = PAD.contact(tip, x, y, rng.choice(levels("", tip, LOW_N, HIGH_N)))
        frame = PAD.sensor.render(contact, rng).image
        marks = tracker.settled(tracker.follow(frame), frame, 300).points
        lost += 300 - len(marks)
        seen, true = own.cues(marks), meter.cues(PAD.marks(contact, rng))
        rows.append((contact.force_n, seen, true))
    return rows, lost


def main(presses: int) -> None:
    begun = time.time()
    learnt = slow_presses(PAD, presses, 1, TIPS, LOW_N, 8.2, of=presses // 2)
    unseen = slow_presses(PAD, 2 * presses, 2, TIPS, LOW_N, 8.1, shift=0.5, of=presses // 2)
    for law in ("published", "placed", "any-tip"):
        found = scored(fitted(learnt, law), unseen)
        say(f"both tips, law {law}", found)
    tenths = np.clip(((found[:, 2] - LOW_N) / (HIGH_N - LOW_N) * 10).astype(int), 0, 9)
    print("tenths of the range hold", [f"{100 * found[tenths == k, 1].mean():.0f}" for k in range(10)],
          "of", np.bincount(tenths, minlength=10).tolist())  # fmt: skip
    print("baselines, same folds:", baseline_errors(learnt, usable(learnt)))
    best = fitted(learnt)
    print("own folds", best.mae_n)
    rows, lost = rendered()
    seen = [(best.read(a).value - f, best.read(b).value - f, f) for f, a, b in rows]
    seen = np.array([r for r in seen if r[2] < HIGH_N])
    print(f"rendered: {len(rows)} frames, {lost} marks lost; error {np.abs(seen[:, 0]).mean():.3f} N, "
          f"mean {seen[:, 0].mean():+.3f}; of true marks {np.abs(seen[:, 1]).mean():.3f} N, mean "
          f"{seen[:, 1].mean():+.3f}; from 6 N on {np.abs(seen[seen[:, 2] > 6, 0]).mean():.3f}")  # fmt: skip
    for tip in TIPS:
        alone = slow_presses(PAD, presses // 2, 3, (tip,), LOW_N, 8.2)
        test = slow_presses(PAD, presses // 2, 4, (tip,), LOW_N, 8.1, shift=0.5)
        for law in ("published", "placed", "any-tip"):
            say(f"{tip} alone, law {law}", scored(fitted(alone, law), test))
    copies(best)
    print(f"{time.time() - begun:.0f} s", flush=True)
    hysteresis()
    print(f"{time.time() - begun:.0f} s")


def copies(calibration) -> None:
    """Twelve copies, before and after one weight of the round tip."""
    gathered = {"unknown": [], "weighed": [], "as if the same": []}
    worst = dict.fromkeys(gathered, 0.0)
    for number in range(1, 13):
        pad = VirtualPad(str(number), number)
        rng = np.random.default_rng(number)
        test = slow_presses(pad, 60, 100 + number, TIPS, LOW_N, 8.1, shift=0.5)
        weight = pad.contact("round", 0.0, 0.0, levels(pad.copy, "round", LOW_N, HIGH_N)[20])
        laid = [pad.meter().cues(pad.marks(weight, rng)) for _ in range(4)]
        given = weight.force_n * (1 + 0.005 * rng.standard_normal())
        one = {
            "as if the same": calibration,
            "unknown": calibration.on_copy(),
            "weighed": calibration.weighed(laid, given, 0.005 * given),
        }
        for name, each in one.items():
            found = scored(each, test)
            gathered[name].append(found)
            worst[name] = max(worst[name], float(np.abs(found[:, 0]).mean()))
    for name, parts in gathered.items():
        say(f"12 copies, {name} (worst copy {worst[name]:.3f} N)", np.concatenate(parts))


def hysteresis() -> None:
    """Cycles at 0.5 mm/s, loading and unloading."""
    learnt, unseen = cycles(PAD, 60, 1), cycles(PAD, 60, 2)
    for law in ("published", "placed", "any-tip"):
        calibration = fitted(learnt, law, hysteresis=True)
        memory, _ = follow_memory(calibration.remembering, unseen.cues, unseen.time_s, unseen.press)
        say(f"cycles, law {law}, history known", scored(calibration, unseen, memory))
        say(f"cycles, law {law}, history unknown", scored(calibration, unseen))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 900)
