"""The loop keeps both cues, each of them by itself, and ends in one safe state whatever fails."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import DeviceError, ManualClock, SafetyError
from palpate.devices import OperatorControl
from palpate.devices.device_proxies import ArmProxy, DisplayProxy
from palpate.devices.motion_limits import Reason, Tripped
from palpate.devices.operator_control import OperatorCommand, OperatorInterrupt
from palpate.mechanics.half_space.hertz import Body
from palpate.softness import Characteristic, Mode, SoftObject, hertz_object
from palpate.softness.control.rendering_loop import WISHED, RenderingLoop
from palpate.softness.control.servos import ArmServo, BenchState, PidServo, ReferenceTable
from palpate.softness.display_parts import Chamber, FingerPresses, depth_for
from palpate.softness.rendering_simulation import Rendering, law_of, simulate
from palpate.softness.virtual.rendering_bench import BenchParts, RenderingBench

FINGER = Body(100e3 / 0.75, 15e-3)
BALL = hertz_object("ball", Body(50e3 / 0.75, 20e-3), FINGER, 8.0)


def table_of(name: str, area_mm2, area_n, way_mm, way_n) -> SoftObject:
    return SoftObject(
        name, Characteristic("area", 1e-6 * np.array(area_mm2), np.array(area_n, float)),
        Characteristic("displacement", 1e-3 * np.array(way_mm), np.array(way_n, float)), "a test",
    )  # fmt: skip


FOAM = table_of("foam", [0.0, 20, 130], [0, 0.6, 3.9], [0.0, 6], [0, 3.9])
SOFT = table_of("soft", [0.0, 130], [0, 1.5], [0.0, 12], [0, 1.5])
STIFF = table_of("stiff", [0.0, 40, 130], [0, 1, 5], [0.0, 1, 3], [0, 1, 5])
PEAKS = {"ball": 1.4, "foam": 3.0, "soft": 1.2, "stiff": 4.0}


def pressed(soft: SoftObject, mode: Mode = Mode.BOTH, **how) -> Rendering:
    return simulate(soft, mode, **{"peak_n": PEAKS[soft.name], "presses": 2, **how})


@pytest.mark.parametrize("soft", [BALL, FOAM, SOFT, STIFF], ids=lambda one: one.name)
@pytest.mark.parametrize("frequency_hz", [1.0, 3.0])
@pytest.mark.cases(3)
def test_both_cues_are_kept_within_five_and_four_hundredths_of_the_peak(soft, frequency_hz) -> None:
    felt = pressed(soft, frequency_hz=frequency_hz)
    assert felt.peak_n == pytest.approx(PEAKS[soft.name], rel=0.05)
    assert felt.share(felt.off_area_n()) < 0.05
    assert felt.share(felt.off_displacement_n()) < 0.04


def test_a_servo_that_knows_no_gas_keeps_the_area_worse() -> None:
    knows, alone = (pressed(BALL, frequency_hz=3.0, servo=one) for one in (None, PidServo()))
    assert alone.share(alone.off_area_n()) > 1.5 * knows.share(knows.off_area_n())


def test_in_cm3_the_surface_stays_and_the_area_follows() -> None:
    felt = pressed(BALL, Mode.CUTANEOUS)
    assert np.abs(felt.displacement_m[felt.scored]).max() < 0.2e-3
    assert felt.share(felt.off_area_n()) < 0.05


def test_in_cm2_the_arm_alone_gives_the_displacement_s_curve() -> None:
    felt = pressed(STIFF, Mode.KINESTHETIC)
    assert felt.share(felt.off_displacement_n()) < 0.05
    assert np.all(felt.pushed_m == 0.0)


def test_the_arm_s_error_is_nought_where_the_printed_reference_is_met() -> None:
    """delta_d = beta^-1(alpha(A)) - (H / R) sqrt(P / (p pi)), the report's, at every push."""
    table = ReferenceTable(law_of(FOAM, Mode.BOTH, BenchParts(chamber=Chamber(sleeve_n_m=0.0))))
    law, servo = table.law, ArmServo()
    for pushed in np.linspace(1e-3, 9e-3, 17):
        state = law.at(pushed)
        force, pressure = float(state.force_n[0]), float(state.pressure_pa[0])
        whole = float(FOAM.displacement.at_force(force))
        arm = whole - law.display.height_m / law.display.radius_m * math.sqrt(force / (pressure * math.pi))
        now = BenchState(float(pushed), 0.0, arm, 0.0, force)
        error, _ = servo.error(Mode.BOTH, now, table.at(float(pushed), now.displacement_m), touched=True)
        assert error == pytest.approx(0.0, abs=2e-6)
        late = replace(now, arm_m=arm - 1e-4)
        error, _ = servo.error(Mode.BOTH, late, table.at(float(pushed), late.displacement_m), touched=True)
        assert 0.0 < error < 1e-4


class TestLoop:
    """One loop on a bench, tick by tick."""

    presses = FingerPresses(depth_for(FOAM, 2.5, BenchParts().finger), 1.0, starts_s=0.0)

    def setup_method(self) -> None:
        self.clock = ManualClock()
        self.bench = RenderingBench(self.clock, self.presses)
        self.display = DisplayProxy(self.bench.display, self.clock)
        self.arm = ArmProxy(self.bench.arm, self.clock)
        self.table = ReferenceTable(law_of(FOAM, Mode.BOTH, self.bench.parts))
        self.control = OperatorControl()
        self.loop = RenderingLoop(self.display, self.arm, self.table, self.clock, control=self.control)

    def ticks(self, seconds: float) -> None:
        for _ in range(round(1000 * seconds)):
            self.loop.tick()
            self.clock.sleep(1e-3)

    def safe(self) -> bool:
        """Whether the chamber vents and the arm carries nothing, a moment from now."""
        self.clock.sleep(0.06)
        truth = self.bench.truth()
        return self.bench.opening == -1.0 and truth.pressure_pa < 2e3 and self.bench.force_n == 0.0

    def test_the_operator_s_stop_ends_in_the_safe_state(self) -> None:
        self.ticks(0.5)
        self.control.ask(OperatorCommand.ESTOP)
        with pytest.raises(OperatorInterrupt):
            self.loop.tick()
        assert self.safe()
        with pytest.raises(SafetyError, match="has ended"):
            self.loop.tick()

    def test_an_emergency_stop_past_the_loop_holds_both_devices(self) -> None:
        self.ticks(0.5)
        self.display.hold()
        self.arm.hold()
        with pytest.raises(OperatorInterrupt):
            self.loop.tick()
        assert self.safe()

    def test_an_emergency_stop_in_mid_period_is_the_reason_and_not_the_device_that_refuses(self) -> None:
        self.ticks(0.5)

        def refuses(*_) -> None:
            self.control.ask(OperatorCommand.ESTOP)
            raise DeviceError("the display is vented")

        self.display.set_pressure = refuses  # type: ignore[method-assign]
        with pytest.raises(OperatorInterrupt) as caught:
            self.loop.tick()
        assert caught.value.command is OperatorCommand.ESTOP
        assert self.loop.safe == WISHED[OperatorCommand.ESTOP]

    def test_a_process_that_stands_still_is_found_out_by_the_devices_and_then_by_the_loop(self) -> None:
        self.ticks(0.5)
        self.clock.sleep(4.1e-3)
        self.bench.follow()
        assert self.bench.opening == -1.0
        assert self.bench.force_n == 0.0
        with pytest.raises(Tripped) as caught:
            self.loop.tick()
        assert caught.value.reason is Reason.LOOP_LATE
        assert self.safe()

    @pytest.mark.parametrize("wrong", [math.nan, math.inf])
    def test_a_reference_that_is_no_number_is_told_to_nobody(self, wrong) -> None:
        self.ticks(0.3)
        spoilt = replace(self.table.at(3e-3, 1e-3), pressure_pa=wrong)
        self.table.at = lambda pushed, whole: spoilt  # type: ignore[method-assign]
        told = self.bench.opening
        with pytest.raises(Tripped) as caught:
            self.loop.tick()
        assert caught.value.reason is Reason.REFERENCE
        assert told != -1.0
        assert self.safe()

    def test_a_display_that_cannot_be_vented_does_not_keep_the_arm_from_braking(self) -> None:
        self.ticks(0.5)

        def fails() -> None:
            raise DeviceError("no answer")

        self.bench.display.vent = fails  # type: ignore[method-assign]
        self.loop.make_safe("a test")
        assert self.bench.force_n == 0.0
        assert "no answer" in self.loop.safe
        self.clock.sleep(5e-3)
        self.bench.follow()
        assert self.bench.opening == -1.0  # by its watchdog

    def test_a_new_object_is_there_within_a_second_and_without_a_jump_of_force(self) -> None:
        self.ticks(0.5)
        self.loop.show(ReferenceTable(law_of(SOFT, Mode.BOTH, self.bench.parts)))
        before, steps = self.loop.tick().force_n, []
        for _ in range(400):
            self.clock.sleep(1e-3)
            now = self.loop.tick()
            steps.append(abs(now.force_n - before))
            before = now.force_n
        assert max(steps) < 0.1
        wanted = SOFT.area.force_at(now.area_m2)
        assert now.force_n == pytest.approx(float(wanted), abs=0.08)

    def test_an_object_in_another_mode_is_refused_while_a_finger_may_be_there(self) -> None:
        with pytest.raises(SafetyError, match="CM3"):
            self.loop.show(ReferenceTable(law_of(FOAM, Mode.CUTANEOUS, self.bench.parts)))

    def test_references_of_another_display_are_refused(self) -> None:
        parts = BenchParts(shape=replace(self.bench.parts.shape, radius_m=8e-3))
        with refused("references-of-another", SafetyError, match="8 mm"):
            RenderingLoop(
                self.display, self.arm, ReferenceTable(law_of(FOAM, Mode.BOTH, parts)), self.clock
            )  # fmt: skip
