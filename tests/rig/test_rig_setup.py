"""The guided setup, walked on fakes as in a lab: a stage at a port, a force box, a camera, a weight."""

from __future__ import annotations

import os
import random
import sys
import threading
import tomllib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.fakes.marlin_firmware import MarlinFaults, MarlinFirmware, MarlinParameters
from tests.fakes.netft_box import FakeNetFT, FakePage
from tests.fakes.printing_scale import PrintingScale
from tests.refusals import refused
from tests.rig.conftest import GrblBench
from tests.rig.lab_files import CAMERA, lab_file, palpate, pushed, served
from typer.testing import CliRunner

from palpate.cli import app
from palpate.core import Clock, MonotonicClock, Wrench
from palpate.core.clock import NS_PER_S
from palpate.core.errors import DeviceError, ExistsError, InputError, PositionUnknownError, RangeError
from palpate.devices.motion_limits import Tripped
from palpate.rig.commissioning.rig_setup import PRESS_MM_S, set_up
from palpate.rig.commissioning.setup_answers import Answers
from palpate.rig.plans import Grid, StepHold
from palpate.rig.real.grbl import GrblSpec, GrblStage
from palpate.rig.rig_file import LimitsPart, open_rig, read_rig

SURFACE_MM = 5.5  # of the skin, in the sensor's z
STIFFNESS_N_MM = 4.0
WEIGHT_G = 200.0
G = 9.80665
OFFSET_N = (0.4, -0.2, 7.0)  # the box is not zeroed


LABS: dict[str, Lab] = {}


class LabForce:
    """A force sensor of 500 samples/s that needs no thread, so that a busy machine loses none."""

    rate_hz, range_n = 500.0, (30.0, 30.0, 60.0)

    def __init__(self, lab: str, clock: Clock) -> None:
        self._lab, self._clock, self._due_ns = LABS[lab], clock, clock.now_ns()
        self._kept: list[Wrench] = []
        self._open = True
        self._fill()

    def drain(self) -> list[Wrench]:
        self._fill()
        taken, self._kept = self._kept, []
        return taken

    def latest(self) -> Wrench:
        self._fill()
        return self._newest

    def _fill(self) -> None:
        if not self._open:
            raise DeviceError("it was closed")
        while self._due_ns <= self._clock.now_ns():
            self._newest = Wrench(self._due_ns, self._lab.force(0.0))
            self._kept.append(self._newest)
            self._due_ns += 2_000_000

    def close(self) -> None:
        self._open = False


@dataclass
class Lab:
    """What stands on the table: the skin under the probe, and whether the weight lies on the sensor."""

    bench: GrblBench
    box: FakeNetFT
    weight_lies: bool = False
    scale: float = 1.0  # read over true
    sign: float = -1.0  # of a press, along the box's own z
    dead: bool = False
    deepest_mm: float = 0.0
    hand_n: float = 0.0  # force of a hand on the force sensor

    def force(self, t: float) -> tuple[float, float, float]:
        noise = [random.gauss(0.0, 0.002) for _ in "xyz"]
        depth_mm = -self.bench.firmware.place_mm[2] - SURFACE_MM  # -Z of the machine leads into the skin
        self.deepest_mm = max(self.deepest_mm, depth_mm)
        press_n = 0.0 if self.dead else STIFFNESS_N_MM * max(depth_mm, 0.0)
        press_n += WEIGHT_G * 1e-3 * G * self.weight_lies
        press_n += self.hand_n * (not self.dead)
        true = (0.0, 0.02 * press_n, self.sign * press_n)
        x, y, z = (o + self.scale * f + n for o, f, n in zip(OFFSET_N, true, noise, strict=True))
        return x, y, z


class LabAnswers(Answers):
    """Answers from a file, of somebody who also lays the weight on and takes it off."""

    def __init__(self, lab: Lab, answers: dict[str, Any]) -> None:
        super().__init__(answers, yes=True)
        self.lab = lab

    def ask(self, name: str, question: str, proposal: Any = None, *, words: bool = False) -> Any:
        if name in ("weight_lies", "weight_off"):
            self.lab.weight_lies = name == "weight_lies"
        return super().ask(name, question, proposal, words=words)


@contextmanager
def lab(no_banner: bool = False, hold: int = 255, **kwargs: Any) -> Iterator[Lab]:
    pytest.importorskip("serial", reason="the stage's driver needs pyserial")
    with ExitStack() as stack:
        model = GrblParameters(
            homed=True, start_mm=(-50.0, -50.0, -5.0), settings={1: hold, 120: 500, 121: 500, 122: 500}
        )
        bench = GrblBench(stack, MonotonicClock(), model, GrblFaults(no_banner=no_banner))
        box = stack.enter_context(FakeNetFT(page=FakePage(ranges="30;30;60;3;3;3")))
        made = Lab(bench, box, **kwargs)
        box.force = made.force
        LABS["bench 2"] = made
        stack.enter_context(pushed(made))
        yield made


def answers_of(one: Lab, **changed: Any) -> LabAnswers:
    return LabAnswers(
        one,
        {
            "name": "bench 2", "stage_ports": [one.bench.terminal.path], "boot_s": 0.05, "latency_s": 0.01,
            "force_kind": "tests.rig.test_rig_setup:LabForce", "force_options": {"lab": "bench 2"},
            "camera_kind": CAMERA, "may_move": True, "home": False,
            "reach_mm": 4.0, "mass_g": WEIGHT_G, "mass_tolerance_g": 0.2, "weight_lies": True,
        }
        | changed,
    )  # fmt: skip


def walked(one: Lab, out: Path, **changed: Any) -> Any:
    said: list[str] = []
    made = set_up(out, answers_of(one, **changed), said.append)
    return made, tomllib.loads(out.read_text()), "\n".join(said)


@pytest.mark.slow
def test_a_walk_through_the_setup_finds_sign_surface_and_scale_and_ends_in_the_check(tmp_path: Path) -> None:
    with lab(scale=0.5) as one:
        made, file, said = walked(one, tmp_path / "rig.toml", write_scale=True)
    assert "grbl" in said
    assert file["force"]["axes"] == ["x", "y", "-z"]
    assert file["force"]["scale"] == pytest.approx(2.0, abs=file["force"]["scale_uncertainty"])
    assert file["force"]["scale_uncertainty"] < 0.02
    assert file["origin_mm"] == pytest.approx([-50.0, 50.0, SURFACE_MM], abs=0.25)
    assert one.deepest_mm < 0.5
    timed = ("s", "Hz", "m/s")  # of a busy machine
    assert [c for c in made.checks if not c.ok and c.unit not in timed] == []
    assert any(c.code.startswith("stage.") and c.ok for c in made.checks)
    assert any("firmware" in line for line in made.unchecked)


@pytest.mark.slow
@pytest.mark.parametrize("answer", [{"still_there": False}, {"still_there": True}, {"hold_motors": True}])
@pytest.mark.cases(1)
def test_a_setup_of_a_stage_that_releases_its_motors_asks_before_it_believes_the_position(tmp_path, answer):
    with lab(hold=25) as one:
        made, _, _ = walked(one, tmp_path / "rig.toml", mass_g=0, **answer)
        assert (one.bench.firmware.settings[1] == 255) is ("hold_motors" in answer)
    assert bool(made.checks) is (answer != {"still_there": False})
    assert any("--position" in line for line in made.unchecked) is ("hold_motors" not in answer)


def test_a_setup_that_may_move_nothing_writes_what_it_found_and_says_what_it_did_not(tmp_path: Path) -> None:
    with lab() as one:
        made, file, _ = walked(
            one, tmp_path / "rig.toml", may_move=False, mass_g=0, latency_s=0.2, force_kind="netft",
            force_host="127.0.0.1", force_rdt_port=one.box.rdt_port, force_http_port=one.box.http_port,
            force_silence_s=0.5, typo=1,
        )  # fmt: skip
        assert one.bench.place_mm == (-50.0, -50.0, -5.0)
        assert b"J=" not in one.bench.received
        usual_m_s = StepHold(places=Grid()).press_mm_s * 1e-3
        assert usual_m_s == PRESS_MM_S * 1e-3
        stage = GrblStage.open(GrblSpec(one.bench.terminal.path, boot_s=0.05, latency_s=0.2))
        with stage:  # a plan may press at its usual speed
            LimitsPart(**file["limits"]).limits().check_speed(usual_m_s, stage.travel)
    assert file["limits"]["greatest_mm"] == [0.0, 100.0, 100.0]
    assert file["limits"]["force_N"] == 15.0
    assert made.checks == []
    said = " ".join(made.unchecked)
    for word in ("sign", "scale", "surface", "rig check", "'typo'", "force_options"):
        assert word in said


def test_a_step_in_a_file_of_answers_is_refused_after_it_and_not_repeated(tmp_path: Path) -> None:
    with lab() as one, pytest.raises(InputError, match="three numbers"):
        set_up(tmp_path / "rig.toml", answers_of(one, above_mm="x 0.5"), lambda line: None)
    assert one.bench.place_mm[0] == pytest.approx(-49.5, abs=0.01)


def test_what_a_person_answered_before_a_setup_failed_is_kept_and_gone_on_with(tmp_path: Path) -> None:
    typed = "\n".join(["bench 7", "", "", "/dev/no-such-port", "", "0.1", "", ""])
    out = tmp_path / "rig.toml"
    ended = CliRunner().invoke(app, ["rig", "setup", "--out", str(out)], input=typed)
    assert ended.exit_code != 0
    kept = tmp_path / "rig.answers.toml"
    assert str(kept) in ended.stderr
    answers = tomllib.loads(kept.read_text())
    assert answers["name"] == "bench 7"
    assert "may_move" not in answers
    assert not out.exists()
    asked = Answers.read(kept, read=lambda question: "typed")
    assert asked.ask("name", "Name") == "bench 7"
    assert asked.ask("host", "Host") == "typed"
    assert asked.again("not that")
    assert asked.ask("name", "Name") == "bench 7"


def typed_by(*words: str, **stated: Any) -> Answers:
    """Somebody who types these, and then goes away."""
    left = list(words)

    def read(question: str) -> str:
        if not left:
            raise EOFError
        return left.pop(0)

    return Answers(stated, read=read)


def test_a_device_that_does_not_answer_is_asked_for_again_with_what_was_said_as_proposal() -> None:
    taken = list[tuple[str, str]]()

    def take(answers: Answers) -> str:
        taken.append((answers.text("host", "Host", "a"), answers.text("port", "Port", "1")))
        if taken[-1][0] != "right":
            raise DeviceError("no answer")
        return "open"

    answers = typed_by("right", "", host="wrong", port="7", later=1)
    assert answers.until_good(lambda: take(answers)) == "open"
    assert taken == [("wrong", "7"), ("right", "1")]
    again = typed_by("wrong", "7", "right", "")
    taken.clear()
    assert again.until_good(lambda: take(again)) == "open"
    assert taken == [("wrong", "7"), ("right", "7")]
    assert again.given == {"host": "right", "port": "7"}


def test_soft_limits_the_wrong_way_round_are_refused(tmp_path: Path) -> None:
    limits = {"least_mm": [-10, 0, 0], "greatest_mm": [-20, 50, 50]}
    with lab() as one:
        answers = answers_of(one, may_move=False, **limits)
        with refused("soft-limits", RangeError, match="-20 mm"):
            set_up(tmp_path / "rig.toml", answers, lambda line: None)
    assert not (tmp_path / "rig.toml").exists()


@pytest.mark.slow
def test_an_old_file_and_limits_beyond_the_firmwares_travel_are_refused(tmp_path: Path) -> None:
    taken = tmp_path / "rig.toml"
    taken.write_text("mine")
    with lab() as one:
        with pytest.raises(ExistsError):
            set_up(taken, answers_of(one), print)
        with pytest.raises(RangeError, match=r"-140.*100"):
            set_up(tmp_path / "new.toml", answers_of(one, least_mm=[-140, 0, 0]), print)
        with pytest.raises(InputError, match=r"99.*30"):
            set_up(tmp_path / "new.toml", answers_of(one, force_N=99), print)
        with pytest.raises(DeviceError, match="0 stages"):
            set_up(tmp_path / "new.toml", answers_of(one, stage_ports=["/dev/no-such-port"]), print)
    assert taken.read_text() == "mine"
    assert not (tmp_path / "new.toml").exists()


@pytest.mark.slow
def test_a_dead_sensor_is_found_before_the_skin_is_pressed_deep(tmp_path: Path) -> None:
    with lab(dead=True) as one, refused("force-dead", Tripped):
        set_up(tmp_path / "rig.toml", answers_of(one, reach_mm=1.0), print)
    assert one.deepest_mm < 1.0
    assert not (tmp_path / "rig.toml").exists()


# The guided setup with each kind of device, and with wrong answers: what a newcomer would stumble over.

pytest.importorskip("serial", reason="a stage's port needs pyserial")
COUNT_N = 2.5e-5
MASS_G = 500.0


def now_s() -> float:
    return MonotonicClock().now_ns() / NS_PER_S


class Person(LabAnswers):
    """Somebody who also lays a weight on the scale."""

    lies = False

    def ask(self, name: str, question: str, proposal: Any = None, *, words: bool = False) -> Any:
        if name.endswith("_weight_lies"):
            Person.lies = True
        return super().ask(name, question, proposal, words=words)


def scale(layout: str = "counts", sign: float = 1.0, rate_hz: float = 20.0) -> PrintingScale:
    Person.lies = False
    return PrintingScale(
        lambda t: sign * MASS_G * 1e-3 * G * Person.lies + random.gauss(0.0, 1e-3), layout=layout,
        rate_hz=rate_hz, delay_s=0.0, count_n=COUNT_N, now_s=now_s(),
    )  # fmt: skip


def walk(one: Any, out: Path, **changed: Any) -> tuple[dict[str, Any], str]:
    said: list[str] = []
    base = answers_of(one, may_move=False, mass_g=0, **changed)._stated
    set_up(out, Person(one, base), said.append)
    return tomllib.loads(out.read_text()), "\n".join(said)


LABEL = {"label_kind": "serial-scale", "label_rate_hz": 20.0, "label_delay_s": 0.0, "label_mass_g": MASS_G}


@pytest.mark.parametrize("sign", [-1.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_known_weight_gives_the_force_of_a_labelling_cells_count_with_its_sign(tmp_path, sign):
    with lab() as one, served(scale(sign=sign)) as port:
        words = {"label_port": port, "label_unit": "counts", "label_weight_lies": True, "label_range_N": 20.0}
        file, said = walk(one, tmp_path / "rig.toml", **LABEL, **words)
    assert file["label_force"]["count_N"] == pytest.approx(sign * COUNT_N, rel=0.004)
    assert file["label_force"]["range_N"] == 20.0
    assert "4.903 N" in said
    assert read_rig(tmp_path / "rig.toml").label_force is not None


@pytest.mark.slow
def test_a_scale_that_prints_a_wrong_unit_is_refused_by_the_known_weight(tmp_path: Path) -> None:
    with lab() as one, served(scale("grams")) as port:
        words = {"label_port": port, "label_unit": "g", "label_weight_lies": True, **LABEL}
        walk(one, tmp_path / "right.toml", **words)
        Person.lies = False
        with refused("weight-differs", InputError, match=r"9\.80. N"):
            walk(one, tmp_path / "wrong.toml", **{**words, "label_mass_g": 2 * MASS_G})
    assert not (tmp_path / "wrong.toml").exists()


@pytest.mark.slow
def test_a_slow_load_cell_is_no_guard_and_is_refused_before_anything_moves(tmp_path: Path) -> None:
    slow = {
        "force_kind": "serial-scale",
        "force_unit": "counts",
        "force_mass_g": MASS_G,
        "force_weight_lies": True,
    }
    with lab() as one, served(scale(rate_hz=10.0)) as port:
        words = {
            "force_port": port, "force_rate_hz": 10.0, "force_delay_s": 0.4, "force_range_N": 20.0, **slow,
        }  # fmt: skip
        with refused("force-delay", InputError, match=r"0\.5 s"):
            walk(one, tmp_path / "rig.toml", **words)
        assert b"$J" not in one.bench.received


@pytest.mark.slow
def test_a_marlin_printer_with_a_fast_load_cell_is_written_and_opens(tmp_path: Path) -> None:
    marlin = MarlinFirmware(MarlinParameters(), MarlinFaults(), now_s())
    fast = {
        "force_kind": "serial-scale", "force_unit": "counts", "force_mass_g": MASS_G,
        "force_weight_lies": True, "force_rate_hz": 80.0, "force_delay_s": 0.05, "force_range_N": 20.0,
    }  # fmt: skip
    with lab() as one, served(marlin) as stage, served(scale(rate_hz=80.0)) as port:
        file, said = walk(
            one, tmp_path / "rig.toml", force_port=port, stage_ports=[stage], stands_mm=[0, 0, 0],
            least_mm=[-20, -20, -20], greatest_mm=[20, 20, 20], **fast,
        )  # fmt: skip
        assert "marlin" in said
        assert file["stage"]["kind"] == "marlin"
        assert file["limits"]["force_latency_s"] == pytest.approx(0.063)
        with pytest.raises(PositionUnknownError):  # a printer releases its motors at rest
            open_rig(str(tmp_path / "rig.toml"))
        rig = open_rig(str(tmp_path / "rig.toml"), position="reference")
        assert rig.stage.position_m() == pytest.approx((0.0, 0.0, 0.0))
        rig.close()


def test_a_person_who_answers_wrongly_is_asked_again_and_a_file_is_not(capsys):
    def typed(*lines: str) -> Callable[[str], str]:
        rest = iter(lines)
        return lambda question: next(rest)

    assert Answers(read=typed("many", "99", "7")).number("n", "How many", 0.0, 10.0) == 7.0
    assert Answers(read=typed("perhaps", "yes")).confirm("c", "Is it so")
    assert Answers(read=typed("1, 2", "[1, 2]", "[1, 2, 3]")).three("t", "Where") == (1.0, 2.0, 3.0)
    assert "99" in capsys.readouterr().err
    with pytest.raises(InputError):
        Answers(yes=True, read=input).number("n", "How many", 0.0, 10.0, 11.0)


@pytest.mark.slow
def test_a_jog_without_a_guard_needs_the_word_for_it_and_keeps_its_limits(tmp_path: Path) -> None:
    with lab_file(tmp_path) as lab_:
        file = lab_.write()
        lab_.box.silent = True
        refused = palpate("rig", "jog", file, "--axis", "x", "--mm", "1")
        assert refused.returncode == 2
        assert "--unguarded" in refused.stderr
        for words in (("--mm", "1", "--speed-mm-s", "5"), ("--mm", "45")):
            assert palpate("rig", "jog", file, "--axis", "x", "--unguarded", *words).returncode == 2
        assert not lab_.jogged
        done = palpate("rig", "jog", file, "--axis", "x", "--mm", "1", "--unguarded")
        assert done.returncode == 0, done
        assert lab_.stage.place_mm[0] == pytest.approx(-49.0, abs=0.01)


@pytest.mark.skipif(os.name != "posix", reason="needs a pseudo-terminal")
def test_what_was_typed_before_a_question_that_moves_the_stage_does_not_answer_it(monkeypatch) -> None:
    master, slave = os.openpty()
    with open(slave) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        answers = Answers(read=lambda question: terminal.readline())
        os.write(master, b"palm\n")
        assert answers.text("design", "Design") == "palm"
        os.write(master, b"yes\n")
        later = threading.Timer(0.5, os.write, (master, b"no\n"))
        later.start()
        assert answers.confirm("home", "Home the stage now", True) is False
        later.join()
    os.close(master)
