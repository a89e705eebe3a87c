"""Record on the virtual rig for half an hour, as fast as it goes, and draw what memory the process takes.

    python benchmarks/recordings/recording_memory.py                          # 30 minutes, into docs/images
    python benchmarks/recordings/recording_memory.py --minutes 7 --out /tmp   # shorter, elsewhere

The plan is far longer than that; the recording is stopped when the time is over, read again and thrown away.
Frames are tiny, so that there are many: what grows, grows by the frame, the shot or the force sample, and not
by the pixel. Writes recording-memory.csv and .png. The exit status is 1 where memory has left its value after
the first five minutes by more than 5 %, or the run is not sound.
"""

from __future__ import annotations

import argparse
import csv
import os
import tempfile
import threading
import time
from pathlib import Path

from palpate.core import NS_PER_S, ManualClock
from palpate.devices import OperatorCommand, OperatorControl
from palpate.rig import Status, record
from palpate.rig.plans import Grid, StepHold
from palpate.rig.rig import Rig
from palpate.rig.virtual import virtual_rig
from palpate.sensors import palm
from palpate.sensors.palm.palm_sensor import Palm

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
EVERY_S = 5.0
SETTLED_MIN = 5.0  # until then what is built once is being built
ALLOWED = 0.05
COLUMNS = ("minutes", "memory_MB", "frames", "force_samples", "written_MB", "recorded_minutes")
PLAN = StepHold(
    name="memory",
    places=Grid(pitch_mm=2.0),
    cycles=400,
    depth_mm=1.2,
    step_mm=0.4,
    frames=3,
    reference_frames=1,
    clearance_mm=0.4,
    travel_mm_s=50.0,
    taps=0,
)
Row = tuple[float, float, int, int, float, float]


def memory_mb() -> float:
    """Memory of this process that is in use [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


class Sampler:
    """Samples memory, and what was recorded meanwhile, every few seconds, in a thread of its own."""

    def __init__(self, rig: Rig, out: Path, minutes: float) -> None:
        self.rows: list[Row] = []
        self.control = OperatorControl()
        self._rig, self._out, self._minutes = rig, out, minutes
        self._begun_s, self._begun_ns = time.monotonic(), rig.clock.now_ns()
        self._over = threading.Event()
        self._frames = self._samples = 0
        grab, drain = rig.camera.grab, rig.force.drain

        def counted_grab(timeout_s: float):
            self._frames += 1
            return grab(timeout_s)

        def counted_drain():
            drained = drain()
            self._samples += len(drained)
            return drained

        rig.camera.grab, rig.force.drain = counted_grab, counted_drain
        self._thread = threading.Thread(target=self._work, daemon=True)

    def __enter__(self) -> Sampler:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def watch(self, status: Status) -> None:
        """Stop the recording when its time is over."""
        if time.monotonic() - self._begun_s > 60 * self._minutes:
            self.control.ask(OperatorCommand.STOP)

    def _work(self) -> None:
        while not self._over.wait(EVERY_S):
            minutes = (time.monotonic() - self._begun_s) / 60
            written = sum(path.stat().st_size for path in self._out.glob("*")) if self._out.exists() else 0
            recorded = (self._rig.clock.now_ns() - self._begun_ns) / NS_PER_S / 60
            row = (minutes, memory_mb(), self._frames, self._samples, written / 1e6, recorded)
            self.rows.append(row)
            if len(self.rows) % 12 == 0:
                print("min {:.1f}: {:.1f} MB, {} frames, {} forces".format(*row[:4]), flush=True)


def grown(rows: list[Row]) -> float:
    """Greatest share by which memory later leaves its value at the end of the first minutes."""
    begun = [row[1] for row in rows if row[0] >= SETTLED_MIN]
    return max(abs(mb - begun[0]) for mb in begun) / begun[0]


def write(rows: list[Row], out: Path) -> None:
    """Write the table and the curve."""
    with (out / "recording-memory.csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        table.writerows(
            [f"{minutes:.2f}", f"{mb:.1f}", n, m, f"{w:.1f}", f"{r:.1f}"] for minutes, mb, n, m, w, r in rows
        )
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from palpate.reports.calibration_figures import STYLE

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 3.0), layout="constrained")
        axes = figure.add_subplot()
        minutes, mb, frames = ([row[k] for row in rows] for k in range(3))
        settled = next(row[1] for row in rows if row[0] >= min(SETTLED_MIN, rows[-1][0]))
        axes.axhspan(settled * (1 - ALLOWED), settled * (1 + ALLOWED), color="0.92", label="±5 %")
        axes.plot(minutes, mb, label="memory")
        axes.set(xlabel="minutes of recording", ylabel="memory in use [MB]", ylim=(0, 1.3 * max(mb)))
        axes.axvline(SETTLED_MIN, color="0.6", linewidth=0.8)
        right = axes.twinx()
        right.plot(minutes, frames, color="0.5", linestyle="--")
        right.set_ylabel("frames recorded (dashed)")
        axes.legend(loc="lower right", frameon=False)
        figure.savefig(out / "recording-memory.png", dpi=110)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--out", type=Path, default=IMAGES)
    args = parser.parse_args()
    rig = virtual_rig(Palm(palm.cropped(palm.palm(), 16, "tiny")), clock=ManualClock(time.monotonic_ns()))
    with tempfile.TemporaryDirectory(prefix="recording-memory-") as folder:
        out = Path(folder) / "run"
        with Sampler(rig, out, args.minutes) as sampler:
            outcome = record(rig, PLAN, out, control=sampler.control, watch=sampler.watch)
        write(sampler.rows, args.out)
        from palpate.recordings import check

        report = check(out)
    print(f"{outcome.state.value}: {outcome.shots} shots; {report.frames} frames; sound: {report.sound}")
    if sampler.rows[-1][0] <= SETTLED_MIN:
        print(f"too short to say whether memory grows after {SETTLED_MIN:g} min")
        return int(not report.sound)
    share = grown(sampler.rows)
    left = f"memory left its value after {SETTLED_MIN:g} min by {100 * share:.2f} %"
    print(f"{left}; {100 * ALLOWED:g} % are allowed")
    return int(share > ALLOWED or not report.sound)


if __name__ == "__main__":
    raise SystemExit(main())
