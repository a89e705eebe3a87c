"""NUSense's frames a second: a press at a new depth, and its parts.

Run ``python benchmarks/sensors/nusense.py``. Each press is at a depth and place that was not asked for
before, as while an indenter moves; a frame is 640 x 480 px with noise. Compiling, once a machine, is not
counted. Times are those of one processor, so that other work on the machine does not enter them.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

import palpate
from palpate.core import Contact, Pose, PressHistory

PRESSES = 30
DEEP_M, LIGHT_M = 1.5e-3, 0.2e-3
REACH_M = 10e-3


def measured_s(work: Callable[[int], object], times: int = PRESSES) -> float:
    """Median processor time of a call [s]."""
    work(-1)
    spent = []
    for k in range(times):
        begun = time.process_time()
        work(k)
        spent.append(time.process_time() - begun)
    return float(np.median(spent))


def main() -> None:
    """Print the table."""
    sensor = palpate.sensor("nusense")
    rng = np.random.default_rng(0)
    places = rng.uniform(-REACH_M, REACH_M, (PRESSES + 1, 2))

    def pressed(words: str, depth_m: float, lateral: bool = False) -> Callable[[int], Contact]:
        probe = sensor.probe(words)

        def one(k: int) -> Contact:
            history = PressHistory(lateral_n=(0.2 + 1e-3 * k, 0.0)) if lateral else PressHistory()
            x, y = places[k]
            return sensor.press(probe, Pose(float(x), float(y), depth_m + 1e-6 * k), None, history)

        return one

    cases = {
        "round, 1.5 mm": pressed("round", DEEP_M),
        "round, 0.2 mm": pressed("round", LIGHT_M),
        "flat, 0.2 mm": pressed("flat", LIGHT_M),
        "round, 1.5 mm, pulled": pressed("round", DEEP_M, lateral=True),
        "two points, 0.5 mm": pressed("two-points:10:14:30", 0.5e-3),
        "edge of 25 mm, 0.5 mm": pressed("edge:25:60", 0.5e-3),
    }
    print(f"frames a second of processor time, medians of {PRESSES}")
    for name, press in cases.items():
        frame_s = measured_s(lambda k, press=press: sensor.render(press(k), rng))
        held = press(0)
        again_s = measured_s(lambda _, held=held: sensor.render(held, rng))
        print(
            f"{name:24} press and frame {1 / frame_s:6.1f} fps, frame of a held press {1 / again_s:6.1f} fps"
        )


if __name__ == "__main__":
    main()
