"""Force stamps that run backwards end a recording by their own name, and the probe is lifted."""

from dataclasses import replace
from typing import Any

import pytest
from tests.rig.rigs import CLEARANCE_MM, CLOCK_NS, near, plan

from palpate.core import NS_PER_S, Wrench
from palpate.devices import Reason
from palpate.recordings import check
from palpate.rig import State, record


class BackdatedForce:
    """A force sensor whose clock is set back by so many seconds at some moment."""

    def __init__(self, force: Any, from_ns: int, back_s: float) -> None:
        self._force, self._from_ns, self._back_ns = force, from_ns, round(back_s * NS_PER_S)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._force, name)

    def drain(self) -> list[Wrench]:
        return [self._dated(one) for one in self._force.drain()]

    def latest(self) -> Wrench:
        return self._dated(self._force.latest())

    def _dated(self, one: Wrench) -> Wrench:
        return replace(one, time_ns=one.time_ns - self._back_ns) if one.time_ns > self._from_ns else one


@pytest.mark.parametrize("after_s", [1.0, 2.0, 3.0, 4.0])
@pytest.mark.cases(1)
def test_force_stamps_that_run_back_are_a_force_fault_and_the_probe_is_lifted(tmp_path, after_s):
    one = near()
    backdated = BackdatedForce(one.force, CLOCK_NS + round(after_s * NS_PER_S), 1.0)
    outcome = record(replace(one, force=backdated), plan(), tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.FORCE_FAULT)
    assert "runs backwards" in outcome.message
    assert one.from_origin_mm(one.stage.position_m())[2] <= -CLEARANCE_MM + 1e-6
    assert check(tmp_path / "run").sound
