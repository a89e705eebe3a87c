"""The guided setup with each kind of device, and with wrong answers: what a newcomer would stumble over."""

import random
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.fakes.marlin_firmware import MarlinFaults, MarlinFirmware, MarlinParameters
from tests.fakes.printing_scale import PrintingScale
from tests.refusals import refused
from tests.rig.lab_files import lab_file, palpate, served
from tests.rig.test_rig_setup import G, LabAnswers, answers_of, lab

from palpate.core import MonotonicClock
from palpate.core.clock import NS_PER_S
from palpate.core.errors import InputError, PositionUnknownError
from palpate.rig.commissioning.rig_setup import set_up
from palpate.rig.commissioning.setup_answers import Answers
from palpate.rig.rig_file import open_rig, read_rig

pytest.importorskip("serial", reason="a stage's port needs pyserial")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal needs POSIX")
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
def test_ctrl_c_at_any_question_writes_nothing_and_moves_nothing(tmp_path: Path) -> None:
    class Leaves(LabAnswers):
        left = 0

        def ask(self, name: str, question: str, proposal: Any = None, *, words: bool = False) -> Any:
            if self.left == 0:
                raise KeyboardInterrupt
            self.left -= 1
            return super().ask(name, question, proposal, words=words)

    with lab() as one:
        for left in (0, 3, 4, 7, 10, 12, 14):
            person = Leaves(one, answers_of(one, may_move=False, mass_g=0)._stated)
            person.left = left
            with pytest.raises(KeyboardInterrupt):
                set_up(tmp_path / "rig.toml", person, lambda line: None)
        assert b"$J" not in one.bench.received
        set_up(tmp_path / "rig.toml", answers_of(one, may_move=False, mass_g=0), lambda line: None)
    assert (tmp_path / "rig.toml").exists()  # the control: each device was given back each time


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
