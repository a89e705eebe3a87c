"""A transient fault rejects one attempt at a press, which is repeated; every other fault ends the run."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from tests.rig.guarded_presses import AlteredForce, ChangedForce, law_range
from tests.rig.rigs import CLEARANCE_MM, CLOCK_NS, keys, near, plan, quick, wanted
from typer.testing import CliRunner

from palpate.cli import app
from palpate.core import NS_PER_S, ManualClock, RangeError, Wrench
from palpate.core.errors import DeviceError, InputError
from palpate.devices import ForceBias, Reason
from palpate.devices.force_trust import StiffnessCorridor, StiffnessRange
from palpate.devices.force_trust.stiffness_corridor import UNKNOWN_N_M
from palpate.recordings import Run, check
from palpate.rig import State, done_in, record
from palpate.rig.engine import DISBELIEVED
from palpate.rig.force_checks import stiffness_lines, stiffness_of
from palpate.rig.label_force import slope_n_s
from palpate.rig.plans import Listed, Ramp
from palpate.rig.preflight import notes_of
from palpate.rig.rig import REJECTED, TRANSIENT, RetryLimits, Rig
from palpate.rig.rig_file.opened_rig import RigFile, rig_from
from palpate.rig.run_progress import fields_of
from palpate.rig.virtual import Variation

PLACE = Listed(kind="listed", at_mm=((0.0, 0.0),))
SMALL = plan(cycles=1, depth_mm=0.8, places=PLACE, frames=1)
DEEP_M = 0.3e-3  # of the stage, below the surface: in the first move after contact
ALLOWED_S = 0.04  # age of a sample at 2 mm/s: 0.08 mm over the speed


class Flaky:
    """A force sensor or camera that fails for some seconds, so often, once the stage has come to some depth.

    It is "late" (keeps samples and stamps them on arrival), "lost" (drops them) or "silent" (raises). The
    offset is added to the normal force from the first lift after that on.
    """

    def __init__(
        self, device: Any, stage: Any, how: str, seconds: float, times: int = 1, offset_n: float = 0.0
    ) -> None:
        self._device, self._stage, self._how, self._seconds = device, stage, how, seconds
        self._clock = stage._world.clock
        self._left, self._offset_n = times, offset_n
        self._until_ns, self._begun, self._was_up, self._moved_n = 0, False, True, 0.0
        self._kept: list[Wrench] = []
        self.deepest_m = -1.0  # since the fault began

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def _on(self) -> bool:
        z, now_ns = self._stage.position_m()[2], self._clock.now_ns()
        self._was_up = self._was_up or z < 0
        if self._was_up and self._left > 0 and z > DEEP_M:
            self._left, self._was_up, self._begun = self._left - 1, False, True
            self._until_ns = now_ns + round(self._seconds * NS_PER_S)
            self.deepest_m = -1.0
        if self._begun:
            self._moved_n = self._offset_n if z < 0 else self._moved_n
            self.deepest_m = max(self.deepest_m, z)
        if now_ns < self._until_ns and self._how == "silent":
            raise DeviceError("no answer")
        return now_ns < self._until_ns

    def _moved(self, one: Wrench) -> Wrench:
        x, y, z = one.force_n
        return replace(one, force_n=(x, y, z + self._moved_n))

    def drain(self) -> list[Any]:
        on, fresh, now_ns = self._on(), self._device.drain(), self._clock.now_ns()
        if on:
            self._kept += fresh if self._how == "late" else []
            return []
        if self._kept:
            fresh, self._kept = [replace(one, time_ns=now_ns) for one in (*self._kept, *fresh)], []
        return [self._moved(one) if isinstance(one, Wrench) else one for one in fresh]

    def latest(self) -> Wrench:
        if not self._on() or not hasattr(self, "_last"):
            self._last = self._device.latest()
        return self._moved(self._last)

    def grab(self, timeout_s: float = 1.0) -> Any:
        if self._on():
            self._clock.sleep(timeout_s)
            raise DeviceError("no frame")
        return self._device.grab(timeout_s)


def recorded(
    out: Path,
    how: str,
    seconds: float,
    *,
    times: int = 1,
    offset_n: float = 0.0,
    limits: RetryLimits | None = None,
    device: str = "force",
    of: Any = SMALL,
) -> tuple[Any, Flaky]:
    """Record a plan on a rig whose device fails for a while."""
    sound = near()
    flaky = Flaky(getattr(sound, device), sound.stage, how, seconds, times, offset_n)
    faulty = replace(sound, **{device: flaky}, retries=limits or RetryLimits())
    return record(faulty, of, out), flaky


@pytest.mark.parametrize(
    ("how", "seconds", "reasons"),
    [
        ("late", 0.042, {Reason.FORCE_LATE}),
        ("lost", 0.042, {Reason.FORCE_LATE}),
        ("lost", 0.2, {Reason.FORCE_LATE, Reason.FORCE_SLOW, Reason.FORCE_STALE}),
        ("silent", 0.5, {Reason.FORCE_SENSOR}),
    ],
)
@pytest.mark.cases(1)
def test_a_press_with_a_transient_fault_is_repeated_and_its_first_attempt_void(
    tmp_path, how, seconds, reasons
):
    outcome, _ = recorded(tmp_path / "run", how, seconds)
    assert outcome.state is State.DONE, outcome
    assert outcome.retries == 1
    run = Run.open(tmp_path / "run")
    (event,) = fields_of(run, REJECTED)
    assert event["reason"] in {one.value for one in reasons}
    assert (event["attempt"], event["cycle"], event["retried"]) == (1, 1, True)
    if how != "silent":
        numbers: Any = event["numbers"]
        assert numbers["allowed_s"] == pytest.approx(ALLOWED_S)
        assert numbers["allowed_s"] < next(v for k, v in numbers.items() if k != "allowed_s")
    assert sorted(keys(run)) == sorted(wanted(SMALL)), "each frame once"
    labels = run.labels
    valid = labels["approach"][labels["shot"].notna()]
    assert not set(valid) & set(event["approaches"])
    assert check(run.path).sound
    with pytest.raises(InputError):
        stiffness_of(run)  # of presses without a fault alone


@pytest.mark.parametrize(
    ("limits", "attempts"),
    [(RetryLimits(0, 20, 0.1), 1), (RetryLimits(2, 20, 0.1), 3), (RetryLimits(5, 1, 0.1), 2)],
    ids=["none", "per press", "per session"],
)
@pytest.mark.cases(2)
def test_retries_end_at_their_limits_with_the_fault_s_code(tmp_path, limits, attempts):
    out = tmp_path / "run"
    outcome, _ = recorded(out, "late", 0.045, times=99, limits=limits)
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.FORCE_LATE)
    events = fields_of(Run.open(out), REJECTED)
    assert [event["retried"] for event in events] == [True] * (attempts - 1) + [False]
    assert outcome.retries == attempts - 1
    assert record(near(clock=ManualClock(3 * CLOCK_NS)), SMALL, out).state is State.DONE
    assert sorted(keys(Run.open(out))) == sorted(wanted(SMALL))


def test_a_sensor_that_stays_silent_is_never_pressed_under_again(tmp_path: Path) -> None:
    outcome, flaky = recorded(tmp_path / "run", "lost", 1e6)
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.FORCE_STALE)
    assert flaky.deepest_m < DEEP_M + 0.25e-3, "the move that was sent, and nothing after it"
    assert len(fields_of(Run.open(tmp_path / "run"), REJECTED)) == 1 + RetryLimits().per_press


def test_a_force_that_is_not_zero_at_the_clearance_ends_the_run(tmp_path: Path) -> None:
    outcome, flaky = recorded(tmp_path / "run", "late", 0.045, offset_n=0.4)
    assert outcome.state is State.FAILED
    assert outcome.reason in (Reason.FORCE_DRIFT, Reason.TOUCHED_EARLY)
    assert flaky.deepest_m < DEEP_M + 0.25e-3
    stands_m = flaky._stage.position_m()[2]
    assert stands_m <= -CLEARANCE_MM * 1e-3 + 1e-9


@pytest.mark.slow
def test_a_sweep_without_frames_for_a_while_is_repeated_and_its_frames_void(tmp_path: Path) -> None:
    swept = Ramp(
        name="ramp", kind="swept", places=PLACE, cycles=1, until_N=2.0, taps=0, clearance_mm=CLEARANCE_MM
    )
    outcome, _ = recorded(tmp_path / "run", "lost", 0.8, device="camera", of=swept)
    assert (outcome.state, outcome.retries) == (State.DONE, 1), outcome
    run = Run.open(tmp_path / "run")
    (event,) = fields_of(run, REJECTED)
    labels = run.labels[run.labels["shot"].notna()]
    assert set(labels["approach"]).isdisjoint(event["approaches"])
    numbers = labels["frame_in_shot"][labels["phase"] == "sweep"].astype(int)
    assert list(numbers) == list(range(len(numbers))), "one sweep, from its first frame to its last"


def test_faults_that_imply_damage_are_never_transient() -> None:
    ends = {
        Reason.FORCE_LIMIT, Reason.FORCE_RATE, Reason.FORCE_FAULT, Reason.FORCE_DRIFT, Reason.TOUCHED_EARLY,
        Reason.STAGE, Reason.STAGE_LATE, Reason.HARDWARE_STOP, Reason.SUPERVISOR, Reason.FORCE_DEAD,
        Reason.FORCE_REVERSED, Reason.FORCE_SCALED, Reason.FORCE_STUCK, Reason.FORCE_IMPLAUSIBLE,
    }  # fmt: skip
    assert not ends & TRANSIENT
    assert not any(RetryLimits().allow(one, 1, 0) for one in ends)


@pytest.mark.parametrize("wrong", [{"per_press": -1}, {"per_session": -1}, {"wait_s": float("nan")}])
def test_limits_of_retries_are_numbers_of_zero_or_more(wrong: dict[str, Any]) -> None:
    with pytest.raises(RangeError):
        RetryLimits(**wrong)


# A force whose zero moves while it presses: found by the zero after the press, taken back, recorded anew.

DRIFT_SMALL = quick(places=Listed(kind="listed", at_mm=((0.0, 0.0),)), cycles=2, press_mm_s=2.0)


def varied() -> Rig:
    return near(variation=Variation(), seed=5)


def drifting(begun_s: float, ended_s: float, slope_n_s: float = 1.0) -> Rig:
    """A rig whose normal zero moves between two times, at so many newtons a second."""
    one = varied()

    def shifted(sample: Wrench) -> Wrench:
        x, y, z = sample.force_n
        seconds = max(min(sample.time_ns / NS_PER_S, ended_s) - begun_s, 0.0)
        return replace(sample, force_n=(x, y, z + slope_n_s * seconds))

    return replace(one, force=ChangedForce(one.force, shifted))


def span_of_last_press(path: Path) -> tuple[float, float]:
    """When the last press of the small plan goes down, and when it is over, on a sound rig [s]."""
    sound = varied()
    assert record(sound, DRIFT_SMALL, path).state is State.DONE
    run = Run.open(path)
    assert len(fields_of(run, "zero-moved")) == 2, "every press ends with a zero, the last included"
    down = run.times_s[run.labels.index[run.labels["phase"] == "down"][-1]]
    begun_s = (sound.clock.now_ns() - run.end_ns + run.manifest.created_ns) / NS_PER_S
    return begun_s + float(down) - 0.3, begun_s + float(down) + 0.1


@pytest.mark.usefixtures("coarse_looks")
@pytest.mark.parametrize(
    "goes_on",
    [False, pytest.param(True, marks=pytest.mark.slow)],
    ids=["ends before the zero", "goes on in the air"],
)
def test_a_press_whose_zero_moved_is_named_taken_back_and_recorded_anew(tmp_path, goes_on):
    begun_s, ended_s = span_of_last_press(tmp_path / "sound")
    out = tmp_path / "run"
    outcome = record(drifting(begun_s, ended_s + (60.0 if goes_on else 0.0)), DRIFT_SMALL, out)
    assert outcome.state is State.FAILED
    assert outcome.reason in ({Reason.FORCE_DRIFT} if not goes_on else DISBELIEVED)
    assert (outcome.shots, outcome.void_shots) == (4, 4)
    assert check(out).void_frames == 4
    assert sorted({key for key, _ in keys(Run.open(out))}) == sorted(done_in(Run.open(out)))
    assert record(varied(), DRIFT_SMALL, out).state is State.DONE
    run = Run.open(out)
    assert sorted(keys(run)) == sorted(wanted(DRIFT_SMALL))
    assert (run.labels["force_N"] - run.labels["true_force_N"]).abs().max() < 0.05


@pytest.mark.slow
def test_a_small_movement_of_the_zero_is_told_as_a_figure(tmp_path: Path) -> None:
    begun_s, ended_s = span_of_last_press(tmp_path / "sound")
    out = tmp_path / "run"
    outcome = record(drifting(begun_s, ended_s, 0.1), DRIFT_SMALL, out)
    assert outcome.state is State.DONE
    assert outcome.zero_moved_n == pytest.approx(0.04, abs=0.01)
    assert check(out).zero_moved_N == outcome.zero_moved_n


def air(slope: float, noise_n: float, seed: int = 0) -> list[Wrench]:
    noise = noise_n * np.random.default_rng(seed).standard_normal(300)
    return [Wrench(i * 1_000_000, (0.0, 0.0, 1e-3 * slope * i + float(e))) for i, e in enumerate(noise)]


@pytest.mark.parametrize("slope", [1.0, -1.0, 0.4])
def test_a_force_that_still_drifts_in_the_air_has_its_slope(slope: float) -> None:
    assert slope_n_s(air(slope, 0.005), ForceBias(noise_n=0.005)) == pytest.approx(slope, abs=0.02)


@pytest.mark.parametrize("noise_n", [0.005, 0.05])
def test_noise_is_no_drift(noise_n: float) -> None:
    before = ForceBias(noise_n=0.005)
    assert all(slope_n_s(air(0.0, noise_n, seed), before) == 0.0 for seed in range(50))


# A stated range of stiffness stops the first press under a force of another gain.

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


@pytest.mark.usefixtures("coarse_looks")
@pytest.mark.parametrize("gain", [0.5, 2.0])
@pytest.mark.cases(1)
def test_the_first_press_under_another_gain_is_stopped_before_its_nominal_depth(tmp_path, gain):
    outcome, beyond_mm = swept(tmp_path / "run", gain)
    assert (outcome.state, outcome.reason, outcome.shots) == (State.FAILED, Reason.STIFFNESS, 0)
    assert beyond_mm < 0.0


@pytest.mark.usefixtures("coarse_looks")
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
