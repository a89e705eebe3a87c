"""What firmware was seen to do: asked of the fake always, of real firmware where a simulator is at hand.

What Grbl 1.1 was seen to do is asked here; what both firmwares must do, in `test_grbl_two_firmwares`.
"""

import time
from contextlib import ExitStack

import pytest
from tests.rig.grbl_talk import Talk, fake, simulator

UNHOMED = ("$20=0", "$22=0", "$21=0", "$13=0", "$10=1")  # nothing to home against
MOTION = ("$120=50", "$121=50", "$122=50", "$110=1200", "$111=1200", "$112=1200")


@pytest.fixture(params=["fake", "simulator"])
def path(request, tmp_path):
    with ExitStack() as stack:
        path = stack.enter_context(fake() if request.param == "fake" else simulator(tmp_path))
        with Talk(path) as talk:
            talk.wake()
            for line in (*UNHOMED, *MOTION, "$X"):
                assert talk.send(line)[-1] == "ok", line
        yield path


@pytest.fixture
def talk(path):
    with Talk(path) as talk:
        yield talk


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("G21G91G94G1X0.01", "error:22"), ("G1X1F-1", "error:4"), ("G1XnanF100", "error:2"),
        ("G1XinfF100", "error:2"), ("G1X1e3F100", "error:20"), ("G1X" + "0" * 97 + "1F100", "error:11"),
        ("$20=1", "error:10"), ("G20", "ok"), ("", "ok"),
    ],
)  # fmt: skip
def test_a_line_has_the_one_answer_that_was_seen(talk, line, answer):
    assert talk.send(line)[-1] == answer


def test_ok_is_not_done(talk):
    assert talk.send("G21G91G94G1X2F300")[-1] == "ok"
    assert talk.status().startswith("<Run")
    talk.until("Idle")
    assert talk.x_mm() == pytest.approx(2.0, abs=0.01)


def test_a_full_planner_answers_one_line_a_move(talk):
    talk.port.write(b"G21G91G94\n")
    talk.hear("ok$")
    began = time.monotonic()
    times = []
    for _ in range(20):
        talk.send("G1X0.2F60")
        times.append(time.monotonic() - began)
    # The last answer had to wait for about four moves of 0.2 s and more; were it at once, it were queued.
    assert times[-1] - times[13] > 0.3
    talk.reset()


def test_a_hold_then_a_reset_keeps_the_place_and_the_lock_off(talk):
    talk.send("G21G91G94G1X30F600")
    time.sleep(0.5)
    talk.port.write(b"!")
    talk.until("Hold:0")
    x_mm = talk.x_mm()
    heard = talk.reset()
    assert not [line for line in heard if line.startswith("ALARM")]
    assert talk.status().startswith("<Idle")
    assert talk.x_mm() == pytest.approx(x_mm, abs=0.01)


def test_a_reset_in_motion_is_alarm_3(talk):
    talk.send("G21G91G94G1X30F600")
    time.sleep(0.5)
    assert "ALARM:3" in talk.reset()
    assert talk.status().startswith("<Alarm")
    assert talk.send("G1X1F60")[-1] == "error:9"


def test_a_reset_undoes_all_modes(talk):
    talk.send("G20G91")
    talk.reset()
    modes = next(line for line in talk.send("$G") if line.startswith("[GC:"))
    assert {"G0", "G21", "G90"} <= set(modes.strip("[]").removeprefix("GC:").split())


@pytest.mark.parametrize(("words", "went_mm"), [("G91X0.01F100", 0.254), ("G21G91X0.01F100", 0.01)])
def test_a_jog_reads_lengths_in_the_unit_left_behind_unless_it_states_its_own(talk, words, went_mm):
    talk.send("G20")
    assert talk.send(f"$J={words}")[-1] == "ok"
    talk.until("Idle")
    assert talk.x_mm() == pytest.approx(went_mm, abs=0.005)
