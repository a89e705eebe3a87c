"""Record a virtual skin, calibrate depth by location, and read places never seen.

Run it to draw the overview. Imported, it computes and draws nothing.
"""

import tempfile
from pathlib import Path

import numpy as np

from palpate import CalibrationPlan, Estimator, certify, open_source, sense
from palpate.workflows import DemoProtocol, record_demo

with tempfile.TemporaryDirectory() as folder:
    here = Path(folder)
    run = record_demo(here / "run", DemoProtocol(), locations=60, seed=0)
    plan = CalibrationPlan(("x_mm", "depth_mm"), split="group:location", size_px=(60, 107), channels=3)
    certify(run, plan, here / "cal")
    new = record_demo(here / "new", DemoProtocol(), locations=20, seed=1)
    touched = ~new.labels["reference"].to_numpy(bool)
    readings = [s.readings["depth_mm"] for s in sense(Estimator.open(here / "cal"), open_source(new.path))]
    frames = [new.frame(row).image for row in (1, 4, 7)]

true_mm = new.labels["depth_mm"].to_numpy()[touched]
read_mm = np.array([reading.value for reading in readings])[touched]
half_mm = np.array([(reading.high - reading.low) / 2 for reading in readings])[touched]


def draw(path: str = "overview.png") -> None:
    """Write three frames and the readings against the truth to an image file."""
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(11, 5.4), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1, 1.25))
    for axis, image, row in zip(left.subplots(3, 1), frames, (1, 4, 7), strict=True):
        axis.imshow(image[6:170, 50:310])  # both regions, without the dark around them
        axis.set_axis_off()
        axis.set_title(f"pressed {new.labels['depth_mm'][row]:.2f} mm deep", fontsize=9, loc="left")
    axis = right.subplots()
    inside = np.abs(read_mm - true_mm) <= half_mm
    axis.errorbar(true_mm, read_mm, half_mm, fmt="none", ecolor="#9cc7c4", elinewidth=1, zorder=1)
    axis.scatter(true_mm[inside], read_mm[inside], s=12, color="#0b7a75", label="truth inside the interval")
    axis.scatter(true_mm[~inside], read_mm[~inside], s=12, color="#c0392b", label="truth outside")
    axis.plot([0.3, 5.1], [0.3, 5.1], color="#1b2a33", lw=0.8)
    axis.set(xlabel="true depth [mm]", ylabel="reading with its 90 % interval [mm]")
    axis.set_title("places never seen (virtual recording)", fontsize=10)
    axis.legend(frameon=False, fontsize=8, loc="upper left")
    axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    draw()
