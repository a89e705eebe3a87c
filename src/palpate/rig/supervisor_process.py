"""Process that owns a rig's stage and force sensor: ``python -m palpate.rig.supervisor_process``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

from palpate.core import ForceSensor, MonotonicClock, Stage
from palpate.devices import Mounting
from palpate.devices.supervisor.guard_supervisor import GuardSupervisor
from palpate.devices.supervisor.owning_process import Send, run_owner
from palpate.rig.rig_file.opened_rig import RigFile, open_guarded


def main() -> int:
    """Guard the devices until the client is gone, lift the probe where it has to be, and end."""
    return run_owner(_open)


def _open(
    first: Mapping[str, Any], clock: MonotonicClock, send: Send, opened: ExitStack
) -> tuple[GuardSupervisor, dict[str, Any]]:
    file = RigFile.model_validate(first["rig"])
    stage, force = open_guarded(file, clock, opened, first.get("position", "stored"))
    assert file.limits is not None
    assert file.force is not None
    limits, mounting = file.limits.limits(), Mounting(file.force.axes)
    return GuardSupervisor(stage, force, limits, mounting, clock, send), _facts(stage, force)


def _facts(stage: Stage, force: ForceSensor) -> dict[str, Any]:
    travel = stage.travel
    stops = (travel.top_speed_m_s, travel.acceleration_m_s2, travel.latency_s)
    return {
        "travel": [travel.least_m, travel.greatest_m, *stops],
        "rate_hz": force.rate_hz,
        "delay_s": getattr(force, "delay_s", 0.0),
        "range_n": force.range_n,
    }


if __name__ == "__main__":
    sys.exit(main())
