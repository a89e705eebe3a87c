"""Process that owns a display and an arm: ``python -m palpate.softness.process.rendering_process``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

from palpate.core import ManualClock, MonotonicClock
from palpate.devices.supervisor.owning_process import Send, run_owner
from palpate.softness.characteristics import SoftObject
from palpate.softness.control.rendering_loop import RenderingLoop
from palpate.softness.control.servos import ReferenceTable
from palpate.softness.process.bench_file import BenchFile, OpenedBench, open_real_bench
from palpate.softness.process.rendering_owner import RenderingOwner
from palpate.softness.process.rendering_session import ObjectPieces, law_row
from palpate.softness.rendering_law import Mode, RenderingLaw

BEGINS_S = 0.5  # after which the virtual finger comes down first
SPARE_S = 5e-3  # by which the virtual devices' watchdogs wait longer than a period may last


def main() -> int:
    """Render until the client is gone, make the devices safe, and end."""
    return run_owner(_open)


def _open(
    first: Mapping[str, Any], clock: MonotonicClock, send: Send, opened: ExitStack
) -> tuple[RenderingOwner, dict[str, Any]]:
    file, mode = BenchFile.model_validate(first["bench"]), Mode(str(first["mode"]))
    pieces = ObjectPieces()
    for piece in first["object"][:-1]:
        pieces.take(piece)
    soft = pieces.whole(first["object"][-1])
    if file.simulated:
        press = float(first["peak_N"]), float(first["frequency_Hz"])
        bench, law = _virtual(file, soft, mode, press, clock)
    else:
        bench = open_real_bench(file, mode, clock, opened)
        law = RenderingLaw(soft, bench.cone, bench.bounds, mode)
    owner = RenderingOwner(bench, law, file.bench_limits(), clock, send)
    return owner, law_row(law)


def _virtual(
    file: BenchFile, soft: SoftObject, mode: Mode, press: tuple[float, float], clock: MonotonicClock
) -> tuple[OpenedBench, RenderingLaw]:
    """The virtual bench; what has to be compiled is compiled before its time begins."""
    from palpate.softness.rendering_simulation import virtual_bench

    still = ManualClock()
    bench, law = virtual_bench(soft, mode, still, *press)
    RenderingLoop(bench.display_if_any, bench.arm, ReferenceTable(law), still).tick()
    still.sleep(1e-3)
    bench.truth()
    watchdog_s = file.bench_limits().late_s + SPARE_S
    bench, law = virtual_bench(soft, mode, clock, *press, starts_s=BEGINS_S, watchdog_s=watchdog_s)
    opened = OpenedBench(
        bench.display_if_any, bench.arm, law.display, law.bounds, file.cone.damping_N_s_m, simulated=True
    )
    return opened, law


if __name__ == "__main__":
    sys.exit(main())
