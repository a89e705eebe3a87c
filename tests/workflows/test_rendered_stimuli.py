"""Stimuli on a display: shown under codes, in the mode of their condition, and a fault costs no judgement."""

import os
import signal
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from tests.psychophysics.sitting_desks import NOW, Desk
from tests.refusals import refused

from palpate.core import DeviceError, InputError
from palpate.psychophysics import Condition, read_judgements
from palpate.psychophysics.experiments import (
    Enrolment,
    Sitting,
    SittingDialogue,
    enrol,
    make_experiment,
    noisy_answers,
)
from palpate.softness import Mode, SoftObject
from palpate.softness.process import BenchFile, RenderingStatus, read_bench
from palpate.workflows import rendered_stimuli
from palpate.workflows.rendered_stimuli import RenderedStimuli

LINE = """
name = "line"
[force_area]
area_mm2 = [0.0, 130.0]
force_N = [0.0, 4.0]
[force_displacement]
displacement_mm = [0.0, 6.0]
force_N = [0.0, 4.0]
"""
BOTH_CUES, ARM, SKIN = Condition.INTEGRATED, Condition.KINESTHETIC, Condition.CUTANEOUS


@dataclass
class Session:
    """A rendering without a process, which fails when it is told to."""

    bench: BenchFile
    soft: SoftObject
    mode: Mode
    peak_n: float
    why: str = ""
    closed: bool = False

    def show(self, soft: SoftObject) -> None:
        if self.why:
            raise DeviceError(self.why)
        self.soft = soft

    def status(self) -> RenderingStatus:
        return RenderingStatus("ended" if self.why else "renders", self.why, self.soft.name, self.mode)

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def sessions(monkeypatch: pytest.MonkeyPatch) -> list[Session]:
    """Renderings that were begun."""
    begun: list[Session] = []

    def begin(*words) -> Session:
        begun.append(Session(*words))
        return begun[-1]

    monkeypatch.setattr(rendered_stimuli, "RenderingSession", begin)
    return begun


def moved(soft: SoftObject) -> float:
    """Displacement at 1 N [m]."""
    return float(np.interp(1.0, soft.displacement.force_n, soft.displacement.x))


def test_each_stimulus_is_its_own_object_under_its_code_in_its_condition_s_mode(sessions, tmp_path) -> None:
    design = make_experiment(tmp_path / "study", "bianchi-2010", 3)
    for path in (design.folder / "objects").glob("*.toml"):
        if path.stem.partition("-")[0] not in ("SH1", "SH5"):  # the curves of a specimen take a second
            path.write_text(LINE)
    with RenderedStimuli(design, read_bench(None)) as display:
        for condition, mode in ((BOTH_CUES, Mode.BOTH), (ARM, Mode.KINESTHETIC), (SKIN, Mode.CUTANEOUS)):
            assert "nothing of" in display.prepare(condition)
            display.show(condition, "SH1", "K")
            first = sessions[-1].soft
            display.show(condition, "SH5", "T")
            display.check()
            assert sessions[-1].mode is mode
            assert (first.name, sessions[-1].soft.name) == ("K", "T")
            if mode is not Mode.CUTANEOUS:  # the fifth has the most softener
                assert moved(sessions[-1].soft) > moved(first)
        assert len(sessions) == 3
        assert [one.closed for one in sessions] == [True, True, False]
        with refused("stimulus-not-rendered", InputError):
            display.show(BOTH_CUES, "SS1", "Z")
    assert sessions[-1].closed


def test_what_has_ended_is_told_of_and_begun_anew(sessions, tmp_path) -> None:
    design = make_experiment(tmp_path / "study", "threshold", 3)
    display = RenderedStimuli(design, read_bench(None))
    with refused("nothing-rendered", DeviceError):
        display.check()
    display.show(BOTH_CUES, "F01", "K")
    sessions[0].why = "a wire is off"
    with refused("rendering-ended", DeviceError):
        display.check()
    assert sessions[0].closed
    display.show(BOTH_CUES, "F02", "T")
    display.check()
    assert len(sessions) == 2


def test_a_device_that_fails_in_a_trial_costs_no_judgement_and_gives_nothing_away(sessions, tmp_path) -> None:
    design = make_experiment(tmp_path / "study", "threshold", 3)
    enrol(design, "P01", Enrolment(True))
    answer, trials = noisy_answers(design, "P01", 0.0), []

    def answers(trial):
        trials.append(trial)
        if len(trials) == 3:
            sessions[-1].why = "a wire is off"
        return answer(trial)

    desk = Desk(["", "q"])  # mended once
    with RenderedStimuli(design, read_bench(None)) as display, Sitting(design, "P01", lambda: NOW) as sitting:
        outcome = SittingDialogue(sitting, desk, display, desk.clock, answers).run()
    assert outcome.complete
    assert trials[2] == trials[3], "it is asked again"
    assert len(trials) == outcome.kept + 1
    assert len(read_judgements(design.folder)) == outcome.kept
    assert not any(name in line for name in design.stimuli for line in desk.told)


def test_an_object_that_is_none_is_found_before_anything_is_shown(tmp_path: Path) -> None:
    design = make_experiment(tmp_path / "study", "threshold", 3)
    (design.folder / "objects" / "F21.toml").write_text("nothing")
    with pytest.raises(InputError, match=r"F21\.toml"):
        RenderedStimuli(design, read_bench(None))


def wait_until(holds, within_s: float = 10.0) -> bool:
    end_s = time.monotonic() + within_s
    while time.monotonic() < end_s:
        if holds():
            return True
        time.sleep(0.02)
    return False


def turned_into_another(display: RenderedStimuli) -> bool:
    """Show one, then another; whether the process that renders says so."""
    with suppress(DeviceError):  # a busy computer may miss a period, which ends a rendering: it is begun anew
        display.show(BOTH_CUES, "F01", "K")
        display.show(BOTH_CUES, "F21", "T")
        return wait_until(lambda: display._session.status().object == "T", 1.0)
    return False


@pytest.mark.slow  # on a busy computer it is begun anew many times
def test_a_virtual_display_renders_turns_into_another_and_its_end_is_told(tmp_path: Path) -> None:
    design = make_experiment(tmp_path / "study", "threshold", 3)
    with RenderedStimuli(design, read_bench(None)) as display:
        assert any(turned_into_another(display) for _ in range(20))
        session = display._session
        if session.status().state != "ended":
            os.kill(session.pid, signal.SIGKILL)
        assert wait_until(lambda: session.status().state == "ended")
        with refused("rendering-ended", DeviceError):
            display.check()
