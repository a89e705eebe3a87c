"""The display on a LabJack against a board that is not there, over real sockets."""

import math
import re
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from threading import Thread

import pytest
from tests.fakes.labjack_board import FakeLabJack
from tests.refusals import refused

from palpate.core import DeviceError, RangeError
from palpate.softness.real import HallTable, LabJackDisplay, LabJackSettings, ModbusTcp, PressureScale

PATIENCE_S = 20.0  # only a test that fails waits so long
HALL = HallTable(volts=(4.5, 0.5), pushed_mm=(0.0, 10.0))
KEY = 0x50414C50


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(1e-3)


def settings(fake: FakeLabJack, /, timeout_s: float = 5.0, **changes: object) -> LabJackSettings:
    """Settings of a patient display, so that a busy computer is not taken for a silent board."""
    made = LabJackSettings(
        host=fake.host,
        port=fake.port,
        hall=HALL,
        setpoint=PressureScale(low_v=0.0, high_v=5.0, high_pa=100e3),
        monitor=PressureScale(low_v=1.0, high_v=5.0, high_pa=100e3),
        greatest_pa=40e3,
        watchdog_s=60,
        timeout_s=timeout_s,
    )
    return replace(made, **changes)  # type: ignore[arg-type]


@pytest.fixture
def board() -> Iterator[FakeLabJack]:
    with FakeLabJack() as made:
        yield made


@pytest.fixture
def display(board: FakeLabJack) -> Iterator[LabJackDisplay]:
    with LabJackDisplay(settings(board)) as made:
        yield made


def test_the_display_sets_and_measures_what_is_there(board: FakeLabJack, display: LabJackDisplay) -> None:
    board.pushed_m = 2.5e-3
    display.set_pressure(20e3)
    assert board.dac0_v == pytest.approx(1.0)
    before = time.monotonic_ns()
    sample = display.latest()
    assert (sample.pushed_m, sample.pressure_pa) == (pytest.approx(2.5e-3), pytest.approx(20e3))
    assert before <= sample.time_ns <= time.monotonic_ns()
    assert sample.fault == ""


def test_opening_sets_zero_volts_before_it_touches_the_watchdog(board: FakeLabJack) -> None:
    with LabJackDisplay(settings(board, watchdog_s=3)):
        assert board.written[0] == (1000, struct.pack(">f", 0.0))
        now = {at: board.register(at) for at in (61600, 61602, 61604, 61610, 61612, 61620, 61640, 61642)}
    assert now == {61600: 1, 61602: 0, 61604: 3, 61610: 1, 61612: KEY, 61620: 0, 61640: 1, 61642: 0}


@pytest.mark.parametrize("product", [4.0, 8.0, math.nan])
def test_another_board_is_refused_and_not_written_to(board: FakeLabJack, product: float) -> None:
    board.product = product
    with pytest.raises(DeviceError, match="product"):
        LabJackDisplay(settings(board))
    assert not board.written
    until(lambda: not board.connections)


@pytest.mark.parametrize("register", [61600, 61604, 61610, 61640])
def test_a_board_that_does_not_keep_its_watchdog_is_refused(board: FakeLabJack, register: int) -> None:
    board.forgets = {register}
    with pytest.raises(DeviceError, match=f"watchdog's settings.*{register}"):
        LabJackDisplay(settings(board))
    assert board.dac0_v == 0.0


@pytest.mark.parametrize("wrong_pa", [-1.0, 40e3 + 1.0, math.nan, math.inf])
def test_a_pressure_outside_the_range_changes_nothing(
    board: FakeLabJack, display: LabJackDisplay, wrong_pa: float
) -> None:
    display.set_pressure(10e3)
    written = list(board.written)
    with refused("pressure", RangeError, match="40000 Pa"):
        display.set_pressure(wrong_pa)
    with pytest.raises(RangeError):
        display.set_pressure(5e3, math.nan)
    assert board.written == written
    display.set_pressure(40e3)


def test_after_a_vent_only_release_allows_pressure(board: FakeLabJack, display: LabJackDisplay) -> None:
    display.set_pressure(30e3)
    display.vent()
    for pressure_pa in (0.0, 30e3):
        with pytest.raises(DeviceError, match=r"vented; .*release"):
            display.set_pressure(pressure_pa)
    assert board.dac0_v == 0.0
    display.release()
    assert board.dac0_v == 0.0
    display.set_pressure(30e3)
    assert board.dac0_v == pytest.approx(1.5)


def test_a_vent_waits_for_no_reading(board: FakeLabJack, display: LabJackDisplay) -> None:
    display.set_pressure(30e3)
    board.fault, board.fault_at, board.slow_s = "slow", 0, 0.8
    reader = Thread(target=display.latest)
    reader.start()
    time.sleep(0.1)
    began = time.monotonic()
    display.vent()
    waited_s = time.monotonic() - began
    assert reader.is_alive()
    assert board.dac0_v == 0.0
    assert waited_s < 0.6
    reader.join()


def test_a_vent_overtakes_a_pressure_that_is_on_its_way(board: FakeLabJack, display: LabJackDisplay) -> None:
    board.fault, board.fault_at, board.faults_left, board.slow_s = "slow", 1000, 1, 0.4
    refused: list[DeviceError] = []

    def press() -> None:
        try:
            display.set_pressure(30e3)
        except DeviceError as error:
            refused.append(error)

    presser = Thread(target=press)
    presser.start()
    time.sleep(0.1)
    display.vent()
    volts = [struct.unpack(">f", data)[0] for at, data in board.written if at == 1000]
    assert 1.5 in volts, "it has come when the vent returns"
    assert volts[-1] == 0.0
    presser.join()
    assert board.dac0_v == 0.0
    assert refused


def test_a_vent_during_a_release_stays(board: FakeLabJack, display: LabJackDisplay) -> None:
    display.vent()
    board.fault, board.fault_at, board.faults_left, board.slow_s = "slow", 60000, 1, 0.3
    venter = Thread(target=lambda: (time.sleep(0.1), display.vent()))
    venter.start()
    with pytest.raises(DeviceError, match="vented while"):
        display.release()
    venter.join()
    with pytest.raises(DeviceError, match="release"):
        display.set_pressure(1e3)


def test_readings_do_not_feed_the_watchdog_and_pressures_do(board: FakeLabJack) -> None:
    with LabJackDisplay(settings(board, watchdog_s=1)) as display:
        display.set_pressure(30e3)
        until(lambda: display.latest().fault == "" and board.dac0_v == 0.0)
        assert board.watchdog_fired >= 1
        with refused("watchdog", DeviceError, match="1 s"):
            display.set_pressure(30e3)
        display.release()
        board.watchdog_fired = 0
        end = time.monotonic() + 1.3
        while time.monotonic() < end:
            display.set_pressure(30e3)
        assert board.watchdog_fired == 0


def test_new_pressures_change_the_line_that_feeds_a_timer_in_hardware(board: FakeLabJack) -> None:
    with LabJackDisplay(settings(board, heartbeat_dio=3, hardware_vent_s=1.0)) as display:
        assert display.range.watchdog_s == 1.0
        for _ in range(3):
            display.set_pressure(1e3)
            time.sleep(0.12)
        assert [data for at, data in board.written if at == 2003] == [b"\0\1", b"\0\0", b"\0\1"]
        display.vent()
        display.latest()
        assert sum(at == 2003 for at, _ in board.written) == 3


def test_the_range_says_what_the_watchdog_really_gives(board: FakeLabJack, display: LabJackDisplay) -> None:
    assert display.range == settings(board).range
    assert (display.range.height_m, display.range.radius_m, display.range.greatest_pa) == (
        10e-3,
        6.5e-3,
        40e3,
    )
    assert settings(board, watchdog_s=1).range.watchdog_s == 2.0


@pytest.mark.parametrize(
    ("volts", "said"),
    [
        ({0: 4.55}, "displacement"),  # -0.125 mm, a tolerance of 0.1 mm
        ({0: 0.45}, "displacement"),
        ({0: math.nan}, "displacement"),
        ({0: -9999.0}, "displacement"),
        ({1: 0.9}, "pressure"),  # -2.5 kPa, a tolerance of 2 kPa
        ({1: 5.1}, "pressure"),
        ({1: math.inf}, "pressure"),
        ({1: 2.72}, "43.0 kPa and may hold 40 kPa"),
        ({0: 5.0, 1: 0.0}, "displacement.*; .*pressure"),
    ],
)
def test_a_reading_off_its_scale_is_a_fault_and_no_number(
    board: FakeLabJack, display: LabJackDisplay, volts: dict[int, float], said: str
) -> None:
    board.inputs_v = volts
    sample = display.latest()
    assert re.search(said, sample.fault)
    if 0 in volts:
        assert math.isnan(sample.pushed_m)
    board.inputs_v = {}
    assert display.latest().fault == ""


@pytest.mark.parametrize(
    ("fault", "asked"),
    [
        *((one, "latest") for one in ("silent", "half", "transaction", "unit", "protocol", "exception")),
        *((one, "set_pressure") for one in ("silent", "function", "length", "drop", "slow")),
    ],
)
def test_an_answer_that_is_lost_vents_until_released(board: FakeLabJack, fault: str, asked: str) -> None:
    with LabJackDisplay(settings(board, timeout_s=0.3)) as display:
        display.set_pressure(30e3)
        board.fault, board.faults_left, board.slow_s = fault, 1, 0.6  # type: ignore[assignment]
        began = time.monotonic()
        with pytest.raises(DeviceError):
            display.latest() if asked == "latest" else display.set_pressure(31e3)
        assert time.monotonic() - began < 5.0
        until(lambda: board.dac0_v == 0.0)
        with pytest.raises(DeviceError, match="release"):
            display.set_pressure(30e3)
        until(lambda: board.connections <= 1 or fault == "exception")
        display.release()
        display.set_pressure(30e3)
        assert display.latest().fault == ""


def test_a_board_that_restarts_has_to_be_released(board: FakeLabJack, display: LabJackDisplay) -> None:
    display.set_pressure(30e3)
    board.restart()
    until(lambda: not board.connections)
    with pytest.raises(DeviceError, match="broke"):
        display.latest()
    with pytest.raises(DeviceError, match="release"):
        display.set_pressure(30e3)
    display.release()
    display.set_pressure(30e3)


def test_a_vent_that_cannot_be_told_says_what_the_watchdog_does(board: FakeLabJack) -> None:
    display = LabJackDisplay(settings(board, timeout_s=0.1))
    board.fault = "silent"
    with refused("vent-failed", DeviceError, match="61 s"):
        display.vent()
    with refused("vent-failed", DeviceError):
        display.close()
    display.close()


def test_a_vent_is_told_again_where_its_first_telling_was_lost(
    board: FakeLabJack, display: LabJackDisplay
) -> None:
    display.set_pressure(30e3)
    board.fault, board.faults_left = "drop", 1
    display.vent()
    assert board.dac0_v == 0.0


def test_closing_vents_and_frees_the_board_and_nothing_follows(board: FakeLabJack) -> None:
    display = LabJackDisplay(settings(board))
    display.set_pressure(30e3)
    display.close()
    assert board.dac0_v == 0.0
    until(lambda: not board.connections)
    display.close()
    display.vent()
    for call in (display.latest, display.release, lambda: display.set_pressure(0.0)):
        with pytest.raises(DeviceError, match="closed"):
            call()


def test_while_a_display_is_open_no_other_program_has_its_board(
    board: FakeLabJack, display: LabJackDisplay
) -> None:
    with pytest.raises(DeviceError, match="cable"):
        LabJackDisplay(settings(board))
    display.set_pressure(1e3)


def test_a_display_without_a_connection_for_its_vent_is_not_opened(board: FakeLabJack) -> None:
    with ModbusTcp(board.host, board.port), pytest.raises(DeviceError) as raised:
        LabJackDisplay(settings(board))
    assert raised.value
    assert all(at == 1000 for at, _ in board.written)
    until(lambda: not board.connections)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"board": "U3"}, "board-unknown"),
        ({"hall_ain": 13}, "line"),
        ({"watchdog_s": 0}, "watchdog-time"),
        ({"height_m": 12e-3}, "hall-table"),
        ({"radius_m": 0.0}, "display-size"),
        ({"greatest_pa": math.nan}, "pressure"),
        ({"greatest_pa": 120e3}, "pressure"),
        ({"setpoint": PressureScale(0.0, 10.0, 60e3)}, "set-point"),
        ({"heartbeat_dio": 4}, "timer"),
        ({"hardware_vent_s": 0.1}, "timer"),
        ({"heartbeat_dio": 23, "hardware_vent_s": 0.1}, "line"),
        ({"heartbeat_dio": 3, "hardware_vent_s": 0.1, "board": "T4"}, "line"),
        ({"heartbeat_dio": 4, "hardware_vent_s": 0.0}, "timer"),
    ],
)
def test_settings_that_no_display_can_have_are_refused(
    board: FakeLabJack, changes: dict[str, object], said: str
) -> None:
    with refused(said, RangeError):
        settings(board, **changes)
