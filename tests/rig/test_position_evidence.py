"""A stored position is used again only with complete evidence; every other case is refused by its code."""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.fakes.marlin_firmware import MarlinFaults, MarlinParameters
from tests.rig.conftest import GrblBench
from tests.rig.grbl_talk import Talk, fake, simulator
from tests.rig.test_marlin_stage import MarlinBench

from palpate.core import DeviceError, ManualClock, PositionUnknownError
from palpate.devices.supervisor.guard_messages import error_fields, error_of
from palpate.rig.real.position_evidence import (
    PositionEvidence,
    PositionFault,
    PositionStore,
    StoredPosition,
    position_fault,
)

HOLDS = {1: 255}
TARGET = (-0.048, 0.048, 0.0463)  # m, in the sensor's frame, of a homed machine
TOLERANCE_M = 1e-5
BOX = {"least_m": (-0.05,) * 3, "greatest_m": (0.05,) * 3, "require_homed": False}

STORED = StoredPosition(47001, "+X +Y +Z 250", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -2.0))
FOUND = PositionEvidence(True, 47001, "+X +Y +Z 250", (0.0, 0.0, -1.0), 0.01)


@pytest.mark.parametrize(
    ("stored", "found", "fault"),
    [
        (STORED, FOUND, None),
        (STORED, replace(FOUND, counts_mm=(0.0, 0.0, -2.009)), None),
        (None, FOUND, PositionFault.NO_RECORD),
        (STORED, replace(FOUND, motors_hold=False), PositionFault.MOTORS_RELEASED),
        (STORED, replace(FOUND, marker=0), PositionFault.MARKER_LOST),
        (STORED, replace(FOUND, marker=47002), PositionFault.MARKER_LOST),
        (replace(STORED, marker=0), replace(FOUND, marker=0), PositionFault.MARKER_LOST),
        (STORED, replace(FOUND, settings="+X +Y +Z 80"), PositionFault.SETTINGS_DIFFER),
        (STORED, replace(FOUND, counts_mm=(0.0, 0.0, -2.02)), PositionFault.COUNTS_DIFFER),
        (STORED, replace(FOUND, counts_mm=(0.02, 0.0, -1.0)), PositionFault.COUNTS_DIFFER),
        (STORED, replace(FOUND, counts_mm=(float("nan"), 0.0, 0.0)), PositionFault.COUNTS_DIFFER),
    ],
)
def test_each_missing_piece_of_evidence_has_its_code(stored, found, fault) -> None:
    assert position_fault(stored, found) is fault


def refused(stage) -> str:
    """Code of the refusal of a position, which every later use repeats."""
    with pytest.raises(PositionUnknownError) as first:
        stage.recall()
    with pytest.raises(PositionUnknownError) as later:
        stage.position_m()
    assert later.value.code == first.value.code
    return first.value.code


def left(bench: GrblBench, target=TARGET) -> None:
    """A session whose position is known, that ends elsewhere."""
    stage = bench.open()
    stage.move_to(target, 0.01)
    bench.arrive(stage)
    stage.close()


@pytest.fixture(params=["1.1h", pytest.param("grblHAL", marks=pytest.mark.slow)])
def grbl(request, grbl_bench):
    def make(settings=HOLDS, *, homed: bool = True, faults: GrblFaults | None = None, **spec) -> GrblBench:
        model = GrblParameters(firmware=request.param, homed=homed, settings=settings)
        return grbl_bench(model, faults, **spec)

    return make


def recalled(bench: GrblBench):
    """A stage of a later session that uses the stored position."""
    stage = bench.open(known=False)
    stage.recall()
    return stage


def test_a_run_that_ended_elsewhere_is_found_there_and_not_by_opening_alone(grbl) -> None:
    bench = grbl()
    with bench.open(known=False) as first:
        assert refused(first) == "no-record"
    left(bench)
    assert not bench.firmware.push((0.0, 0.0, -3.0)), "the motors hold"
    stage = bench.open(known=False)
    with pytest.raises(PositionUnknownError):
        stage.position_m()
    stage.recall()
    assert stage.position_m() == pytest.approx(TARGET, abs=TOLERANCE_M)
    stage._link.out_of_step = (
        True  # as after an answer that never came: the next move resets, and marks, first
    )
    stage.move_to((TARGET[0], TARGET[1], TARGET[2] - 1e-3), 0.01)
    bench.arrive(stage)
    stage.close()
    assert recalled(bench).position_m()[2] == pytest.approx(-1e-3 * bench.place_mm[2], abs=TOLERANCE_M)
    assert -bench.place_mm[2] == pytest.approx(1e3 * TARGET[2] - 1, abs=0.02)


@pytest.mark.parametrize(
    ("held_later", "code"), [(b"", "motors-released"), (b"$1=255\n", "no-record")], ids=["", "later"]
)
def test_a_carriage_pushed_at_rest_with_released_motors_is_refused(
    grbl, held_later: bytes, code: str
) -> None:
    bench = grbl({1: 25})
    left(bench)
    assert bench.firmware.push((0.0, 0.0, -3.0)), "the motors are released"
    bench.say(held_later)
    assert refused(bench.open(known=False)) == code


def test_counts_of_zero_after_a_power_cut_are_not_the_stored_zero(grbl) -> None:
    bench = grbl(HOLDS | {20: 0, 22: 0}, homed=False, **BOX)
    stage = bench.open(known=False)
    stage.reference((0.0, 0.0, 0.0))
    stage.close()
    with bench.terminal.lock:
        bench.firmware.power_up()
        bench.firmware.take()  # the banner precedes the opening
        assert bench.firmware._axes.place_mm == (0.0, 0.0, 0.0)
    assert refused(bench.open(known=False)) == "marker-lost"


@pytest.mark.parametrize(
    ("said", "code"),
    [
        (b"\x18", "marker-lost"),
        (b"S0\n", "marker-lost"),
        (b"$J=G21G91Z3F1000\n", "counts-differ"),
        (b"$102=125\n", "settings-differ"),  # other steps
        (b"$3=4\n", "settings-differ"),  # another direction
    ],
)
def test_a_stage_that_another_program_used_is_refused(grbl, said: bytes, code: str) -> None:
    bench = grbl()
    left(bench)
    bench.say(said)
    if b"$J" in said:
        bench.wait(lambda: bench.speed_mm_s > 0)
        bench.wait(lambda: bench.speed_mm_s == 0)
    assert refused(bench.open(known=False)) == code


@pytest.mark.parametrize("stopped", [False, True])
def test_a_process_killed_in_a_move_leaves_a_position_that_is_found_again(grbl, stopped: bool) -> None:
    bench = grbl()
    stage = bench.open()
    bench.move_to_speed(stage, TARGET, 0.01)
    stage._link.close()  # nothing of the driver runs any more
    if stopped:
        bench.say(b"\x85")
    bench.wait(lambda: bench.speed_mm_s == 0)
    at = recalled(bench).position_m()
    assert at[2] == pytest.approx(-1e-3 * bench.place_mm[2], abs=TOLERANCE_M)
    assert (at == pytest.approx(TARGET, abs=TOLERANCE_M)) is not stopped


def test_a_move_from_an_unknown_position_is_short_and_makes_the_stored_one_invalid(grbl) -> None:
    bench = grbl()
    left(bench)
    stage = bench.open(known=False)
    before = bench.place_mm[2]
    with pytest.raises(ValueError, match="at most"):
        stage.approach(1e-3, 1e-3)
    stage.approach(0.2e-3, 1e-3)
    bench.arrive(stage)
    assert before - bench.place_mm[2] == pytest.approx(0.2, abs=0.01)
    stage.close()
    assert refused(bench.open(known=False)) == "no-record"


@pytest.mark.parametrize(
    "spec", [{"axes": ("-Y", "+X", "-Z")}, {"frame": "(0, 0, 4)"}], ids=["swapped", "reference"]
)
def test_other_axes_or_another_frame_are_refused(grbl, spec) -> None:
    bench = grbl()
    left(bench)
    bench._spec |= spec
    assert refused(bench.open(known=False)) == "settings-differ"


def test_motors_set_to_hold_in_a_session_keep_its_position(grbl) -> None:
    bench = grbl({1: 25})
    stage = bench.open()
    stage.hold_motors()
    stage.move_to(TARGET, 0.01)
    bench.arrive(stage)
    stage.close()
    assert recalled(bench).position_m() == pytest.approx(TARGET, abs=TOLERANCE_M)


@pytest.mark.parametrize("text", ["", "[]", '{"marker": 1e999}', "[" * 100_000])
def test_a_damaged_file_is_no_position(grbl, text: str) -> None:
    bench = grbl()
    left(bench)
    PositionStore(bench.terminal.path)._path.write_text(text)
    assert refused(bench.open(known=False)) == "no-record"


def test_an_alarm_forgets_the_position_for_good(grbl) -> None:
    bench = grbl(faults=GrblFaults(restart_after_mm=1.0))
    stage = bench.open()
    stage.move_to(TARGET, 0.01)
    with pytest.raises(DeviceError):
        bench.arrive(stage)
    stage._link.close()
    bench.say(b"$X\n")
    assert refused(bench.open(known=False)) == "no-record"


def test_a_disk_that_refuses_stores_nothing_and_stops_no_motion(grbl, monkeypatch, tmp_path) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    bench = grbl()
    left(bench)
    assert refused(bench.open(known=False)) == "no-record"


def test_the_code_survives_the_way_from_the_supervisor() -> None:
    error = error_of(error_fields(PositionUnknownError("text", code="counts-differ")))
    assert (type(error), error.code) == (PositionUnknownError, "counts-differ")


# Marlin: the marker is the extruder's logical position.


@pytest.fixture
def marlin():
    """A bench whose last session ended elsewhere."""
    with ExitStack() as stack:

        def make(**model) -> MarlinBench:
            bench = MarlinBench(stack, MarlinParameters(**model), MarlinFaults(), ManualClock())
            stage = bench.open()
            stage.move_to((0.0, 0.0, 0.002), 0.003)
            bench.wait(lambda: not stage.moving())
            stage.close()
            return bench

        yield make


def test_a_marlin_stage_is_found_where_it_was_left(marlin) -> None:
    bench = marlin()
    bench.clock.sleep(1000.0)
    assert not bench.firmware.push((0.0, 0.0, -1.0)), "M84 S0 keeps the motors' current"
    assert recalled(bench).position_m() == pytest.approx((0.0, 0.0, 0.002), abs=2e-5)


@pytest.mark.parametrize(
    ("model", "line", "code"),
    [
        ({}, b"", "marker-lost"),  # it started anew
        ({"extruder": False}, None, "marker-lost"),  # a build without an extruder has no marker
        ({}, b"G92 E0\n", "marker-lost"),
        ({}, b"G91\nG1 Z-1 F120\n", "counts-differ"),
    ],
)
def test_a_marlin_stage_that_was_restarted_or_used_is_refused(marlin, model, line, code: str) -> None:
    bench = marlin(**model)
    with bench.terminal.lock:
        if line == b"":
            bench.firmware.power_up()
            bench.firmware.take()
        bench.firmware.receive(line or b"")
    bench.clock.sleep(5.0)
    bench.terminal.catch_up()
    assert refused(bench.open(known=False)) == code


# What the marker rests on, of the fakes always, and of real firmware where a simulator is at hand.


@pytest.mark.parametrize("firmware", ["1.1h", "grblHAL"])
@pytest.mark.parametrize("kind", [fake, simulator])
def test_jogs_keep_the_marker_and_a_reset_clears_it(tmp_path: Path, kind, firmware: str) -> None:
    with kind(firmware) if kind is fake else simulator(tmp_path, firmware) as path, Talk(path) as talk:
        talk.wake()
        for line in ("$20=0", "$22=0", "$X", "S47001", "$J=G21G91X0.2F300"):
            assert talk.send(line)[-1] == "ok", line
        talk.until("Idle")
        talk.send("$J=G21G91X5F300")
        talk.until("Jog")
        talk.port.write(b"\x85")
        talk.until("Idle")
        assert "S47001" in spindle(talk)
        talk.reset()
        assert "S0" in spindle(talk)


def spindle(talk: Talk) -> str:
    return next(line for line in talk.send("$G") if line.startswith("[GC:"))
