"""A stated range of stiffness stops the first press under a force of another gain."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from tests.rig.guarded_presses import AlteredForce, law_range
from tests.rig.rigs import CLEARANCE_MM, CLOCK_NS, near, plan
from typer.testing import CliRunner

from palpate.cli import app
from palpate.core import ManualClock, RangeError
from palpate.devices import Reason
from palpate.devices.force_trust import StiffnessCorridor, StiffnessRange
from palpate.devices.force_trust.stiffness_corridor import UNKNOWN_N_M
from palpate.recordings import Run
from palpate.rig import State, record
from palpate.rig.plans import Listed, Ramp
from palpate.rig.preflight import notes_of
from palpate.rig.press_retries import RetryLimits
from palpate.rig.rig_file.opened_rig import RigFile, rig_from
from palpate.rig.skin_stiffness import stiffness_lines, stiffness_of
from palpate.rig.virtual import Variation

pytestmark = pytest.mark.usefixtures("coarse_looks")
PLACE = Listed(kind="listed", at_mm=((0.0, 0.0),))
UNTIL_N = 4.0
FACTOR = 1.25
RAMP = Ramp(
    name="ramp", kind="swept", places=PLACE, cycles=1, until_N=UNTIL_N, speed_mm_s=2.0, taps=0,
    threshold_N=0.1, clearance_mm=CLEARANCE_MM,
)  # fmt: skip


def swept(out: Path, gain: float, *, stated: bool = True, seed: int = 1) -> tuple[Any, float]:
    """Record one press to a force under a gain; how far beyond the nominal depth it went [mm]."""
    sound = near(variation=Variation(), seed=seed)
    world = sound.stage._world
    ranges = {RAMP.indenters[0]: law_range(world, FACTOR)} if stated else {}
    force = AlteredForce(sound.force, sound.clock, gain=gain)
    there = replace(sound, force=force, stiffness=ranges)
    outcome = record(there, RAMP, out)
    deepest_m = max(one.depth_m for one in world.touches)
    law = world._skin.law
    nominal_m = float(np.interp(UNTIL_N, law.force_n, law.depth_m))
    return outcome, 1e3 * (deepest_m - nominal_m)


@pytest.mark.parametrize("gain", [0.5, 2.0])
@pytest.mark.cases(1)
def test_the_first_press_under_another_gain_is_stopped_before_its_nominal_depth(tmp_path, gain):
    outcome, beyond_mm = swept(tmp_path / "run", gain)
    assert (outcome.state, outcome.reason, outcome.shots) == (State.FAILED, Reason.STIFFNESS, 0)
    assert beyond_mm < 0.0


def test_a_press_within_the_stated_range_is_recorded(tmp_path: Path) -> None:
    outcome, beyond_mm = swept(tmp_path / "run", 1.0)
    assert outcome.state is State.DONE
    assert abs(beyond_mm) < 0.15


@pytest.mark.slow
def test_without_a_stated_range_half_a_gain_goes_deeper_than_nominal(tmp_path: Path) -> None:
    outcome, beyond_mm = swept(tmp_path / "run", 0.5, stated=False)
    assert outcome.state is State.DONE
    assert beyond_mm > 0.5


@pytest.mark.slow
def test_a_range_from_a_run_finds_the_gain_that_changed_after_it(tmp_path: Path) -> None:
    def there(gain: float, clock_ns: int, **fields: Any) -> Any:
        sound = near(variation=Variation(), clock=ManualClock(clock_ns), seed=3)
        return replace(sound, force=AlteredForce(sound.force, sound.clock, gain=gain), **fields)

    small = plan(cycles=2, places=PLACE, depth_mm=2.0, frames=1, threshold_N=0.1)
    assert record(there(1.0, CLOCK_NS), small, tmp_path / "good").state is State.DONE
    found = stiffness_of(Run.open(tmp_path / "good"))
    assert found.presses >= 2
    assert found.ratio < 2.5
    indenter = small.indenters[0]
    tables = tomllib.loads(stiffness_lines(indenter, found, "2026-11-28"))
    file = RigFile.model_validate({"name": "bench", **tables})
    (part,) = file.stiffness
    assert part.range().least_n_m == pytest.approx(found.range.least_n_m, rel=1e-3)
    said = CliRunner().invoke(app, ["rig", "fit", str(tmp_path / "good")])
    assert said.exit_code == 0, said.output
    assert tomllib.loads(said.stdout)["stiffness"][0]["force_N"] == tables["stiffness"][0]["force_N"]
    stated = {part.indenter: part.range()}
    for gain, state, reason in (
        (1.0, State.DONE, None),
        (0.5, State.FAILED, Reason.STIFFNESS),
        (2.0, State.FAILED, Reason.STIFFNESS),
    ):
        outcome = record(there(gain, 3 * CLOCK_NS, stiffness=stated), small, tmp_path / f"run{gain}")
        assert (outcome.state, outcome.reason) == (state, reason), gain


class TestRange:
    range = StiffnessRange((1.0, 2.0), (100.0, 300.0), (200.0, 500.0))

    @pytest.mark.parametrize(
        ("force_n", "expected"),
        [
            (0.5, (0.0, UNKNOWN_N_M)),
            (1.5, (200.0, 350.0)),
            (9.0, (300.0, UNKNOWN_N_M)),
        ],
    )
    def test_it_is_linear_between_its_forces_and_open_beyond(self, force_n, expected):
        assert self.range.at(force_n) == pytest.approx(expected)
        assert StiffnessCorridor(self.range).stated_n_m(force_n) == pytest.approx(expected)

    @pytest.mark.parametrize(
        "wrong",
        [
            ((), (), ()), ((1.0, 2.0), (1.0,), (2.0, 3.0)), ((2.0, 1.0), (1.0, 1.0), (2.0, 2.0)),
            ((0.0, 1.0), (1.0, 1.0), (2.0, 2.0)), ((1.0,), (2.0,), (2.0,)), ((1.0,), (0.0,), (2.0,)),
            ((1.0,), (1.0,), (float("inf"),)),
        ],
    )  # fmt: skip
    def test_a_range_that_is_none_is_refused(self, wrong: Any) -> None:
        with pytest.raises(RangeError):
            StiffnessRange(*wrong)


class TestFile:
    """What a rig's file states of its force."""

    stiffness = {"indenter": "sphere:10", "force_N": [1, 2], "least_N_mm": [1, 2], "greatest_N_mm": [2, 4]}  # noqa: RUF012
    weight = {"measured_on": "2026-11-28", "mass_g": 200, "factor": 1.01}  # noqa: RUF012

    def opened(self, **tables: Any) -> Any:
        return rig_from(RigFile.model_validate({"name": "bench", "virtual": {}, **tables}))

    def test_its_stiffness_retries_and_weight_reach_the_rig(self) -> None:
        there = self.opened(
            stiffness=[self.stiffness],
            known_weight=self.weight,
            retries={"per_press": 1, "per_session": 5, "wait_s": 0.5},
        )
        assert there.stiffness == {
            "sphere:10": StiffnessRange((1.0, 2.0), (1000.0, 2000.0), (2000.0, 4000.0))
        }
        assert there.weighed_on == "2026-11-28"
        assert there.retries == RetryLimits(1, 5, 0.5)

    @pytest.mark.parametrize("wrong", [{"force_N": [2, 1]}, {"least_N_mm": [3, 2]}, {"greatest_N_mm": [2]}])
    def test_a_range_that_is_none_is_refused(self, wrong: dict[str, Any]) -> None:
        with pytest.raises(ValidationError):
            self.opened(stiffness=[self.stiffness | wrong])

    def test_a_real_rig_notes_a_gain_that_nothing_checks(self) -> None:
        real = replace(self.opened(), seed=None)
        stated = replace(self.opened(stiffness=[self.stiffness]), seed=None)
        assert len(notes_of(real)) == len(notes_of(stated, ["flat:6"])) == 1
        assert "2026-11-28" in notes_of(replace(real, weighed_on="2026-11-28"))[0]
        assert notes_of(stated) == notes_of(stated, ["sphere:10"]) == notes_of(self.opened()) == []
