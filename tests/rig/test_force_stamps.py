"""Force stamps that run backwards end a recording by their own name, and the probe is lifted."""

from dataclasses import replace

import pytest
from tests.rig.altered_force import ChangedForce
from tests.rig.rigs import CLEARANCE_MM, CLOCK_NS, near, plan

from palpate.core import NS_PER_S, Wrench
from palpate.devices import Reason
from palpate.recordings import check
from palpate.rig import State, record


@pytest.mark.parametrize("after_s", [1.0, 2.0, 3.0, 4.0])
@pytest.mark.cases(1)
def test_force_stamps_that_run_back_are_a_force_fault_and_the_probe_is_lifted(tmp_path, after_s):
    one = near()
    set_back_ns = CLOCK_NS + round(after_s * NS_PER_S)

    def dated(sample: Wrench) -> Wrench:
        back = sample.time_ns > set_back_ns
        return replace(sample, time_ns=sample.time_ns - NS_PER_S) if back else sample

    backdated = ChangedForce(one.force, dated)
    outcome = record(replace(one, force=backdated), plan(), tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.FORCE_FAULT)
    assert "runs backwards" in outcome.message
    assert one.from_origin_mm(one.stage.position_m())[2] <= -CLEARANCE_MM + 1e-6
    assert check(tmp_path / "run").sound
