"""Laws of collecting presses: labels are the truth, a run goes on, gaps are named, trembling is refused."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import Frame, InputError, ManualClock, Wrench
from palpate.recordings import Run
from palpate.rig.virtual.virtual_hand import TREMBLING, USUAL, HandHabits, VirtualHand
from palpate.sensing.collection import PressCollector, PressCoverage, Weighing
from palpate.sensing.collection.press_collector import REST, presses_in
from palpate.sensing.collection.press_coverage import LabelledPress

TRUTHS = ("true_depth_mm", "true_force_N", "true_x_mm", "true_y_mm")


def collected(
    out: Path,
    presses: int,
    *,
    seed: int = 0,
    habits: HandHabits = USUAL,
    typed: bool = False,
    most_s: float = 60.0,
) -> PressCollector:
    """A hand's presses on the virtual TacTip."""
    clock = ManualClock()
    hand = VirtualHand("tactip", seed=seed, clock=clock, habits=habits)
    collector = PressCollector(
        out,
        "tactip",
        None if typed else Weighing.by(hand.force),
        frame_late_s=0.008,
        truth=hand.truth,
        truths=TRUTHS,
        clock=clock,
    )
    with collector:
        while len(collector.presses) < presses and clock.now_ns() < most_s * 1e9:
            at_ns, frame = hand.camera.grab()
            if typed:
                held = hand.held(at_ns)
                if held and collector.status["holding"]:
                    collector.label(held.force_n)
            else:
                collector.on_force(hand.force.drain())
            collector.on_frame(replace(frame, arrived_ns=at_ns))
    return collector


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("presses") / "run"
    collected(out, 5, seed=1)
    return out


def test_labels_are_the_true_forces(run: Path) -> None:
    table = Run.open(run).labels
    touched = table[~table.reference.astype(bool) & (table.press != REST)]
    assert touched.press.nunique() == 5
    assert np.abs(touched.force_N - touched.true_force_N).max() < 0.15
    assert np.abs(touched.force_N - touched.true_force_N).mean() < 0.05


def test_frames_of_the_untouched_sensor_are_untouched_and_one_a_press(run: Path) -> None:
    table = Run.open(run).labels
    rest = table[table.reference.astype(bool)]
    assert (rest.true_force_N == 0).all()
    assert (rest.force_N == 0).all()
    assert rest.press.tolist() == ["1", "2", "3", "4", "5"]


def test_each_fifth_press_brings_a_frame_of_no_force_to_learn_from(run: Path) -> None:
    table = Run.open(run).labels
    rest = table[table.press == REST]
    assert len(rest) == 1
    assert not rest.reference.astype(bool).any()
    assert (rest.force_N == 0).all()
    assert (rest.true_force_N == 0).all()
    assert len(presses_in(Run.open(run))) == 5


def test_run_goes_on_and_nothing_is_overwritten(run: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(run, tmp_path / "run"))
    before = Run.open(run)
    images = [before.frame(i).image.copy() for i in (0, len(before) - 1)]
    count = len(before)
    more = collected(run, 6, seed=2)
    after = Run.open(run)
    assert len(more.presses) == 6
    assert len(after) > count
    for i, image in zip((0, count - 1), images, strict=True):
        assert np.array_equal(after.frame(i).image, image)
    assert len(presses_in(after)) == 6


def test_run_of_another_sensor_is_refused(run: Path) -> None:
    with refused("run-differs", InputError):
        PressCollector(run, "palm", Weighing(200.0))


def test_trembling_hand_gives_no_label(tmp_path: Path) -> None:
    collector = collected(tmp_path / "run", 2, habits=TREMBLING, most_s=9.0)
    assert not collector.presses
    assert {one.kind for one in collector.refused} <= {"trembling", "still moving", "too short"}
    assert "trembling" in {one.kind for one in collector.refused}
    assert not len(Run.open(tmp_path / "run"))


def test_typed_weights_label_what_lies_still(tmp_path: Path) -> None:
    habits = HandHabits(weights_n=(1.0, 2.0, 4.0), hold_s=(2.0, 2.0))
    collected(tmp_path / "run", 2, habits=habits, typed=True)
    table = Run.open(tmp_path / "run").labels
    touched = table[~table.reference.astype(bool) & (table.press != REST)]
    assert touched.press.nunique() == 2
    assert np.abs(touched.force_N / touched.true_force_N - 1).max() < 0.1


REGION = (0, 0, 90, 90)


def test_coverage_names_gaps_and_empty_sides() -> None:
    presses = [LabelledPress(f, (x, 45.0)) for f in (0.5, 1.5, 2.5, 4.5) for x in (45.0, 80.0, 45.0)]
    told = PressCoverage.of(presses, REGION, 40, (0.0, 5.0))
    assert (told.presses, told.asked, told.gaps_n) == (12, 40, [(3.0, 4.0)])
    assert told.bare == ["left", "top", "bottom"]
    assert len(told.text.split(", ")) == 5


def test_press_that_is_not_seen_fills_its_bin_of_force_and_hides_no_other() -> None:
    seen = [LabelledPress(f, (45.0, 45.0)) for f in (0.5, 1.5, 4.5)]
    told = PressCoverage.of([*seen, LabelledPress(2.5, None)], REGION, 40, (0.0, 5.0))
    assert (told.presses, told.unplaced) == (4, 1)
    assert told.gaps_n == [(3.0, 4.0)]


def test_what_the_scale_says_is_wrong_is_advice_also_without_a_press(run: Path) -> None:
    said = "its unit changed from g to oz"
    with PressCollector(run, "tactip", Weighing(200.0), truths=TRUTHS) as collector:
        collector.on_force([Wrench(10**9, (0.0, 0.0, 1.0), fault=said)])
        assert said in collector.advice
        collector.on_force([Wrench((2 + k) * 10**9, (0.0, 0.0, 0.0)) for k in range(101)])
        assert said not in collector.advice


def weighed(folder: Path) -> PressCollector:
    """A collector beside a scale of ten samples a second, from time 0 on."""
    return PressCollector(folder / "run", "tactip", Weighing(10.0), clock=ManualClock())


def fed(collector: PressCollector, forces: list[float], begins_s: float, fault: str = "") -> None:
    """Ten samples a second, each beside a frame of noise."""
    for k, force_n in enumerate(forces):
        at_ns = round((begins_s + 0.1 * k) * 1e9)
        collector.on_frame(Frame(np.zeros((8, 8), np.uint8), at_ns / 1e9, arrived_ns=at_ns))
        collector.on_force([Wrench(at_ns, (0.0, 0.0, force_n), fault=fault)])


def test_a_scale_that_says_what_is_wrong_within_a_press_is_not_called_silent(tmp_path: Path) -> None:
    with weighed(tmp_path) as collector:
        fed(collector, [0.0] * 30 + [2.0] * 5, 1.0)
        assert "said" not in collector.advice
        fed(collector, [float("nan")] * 40, 4.5, "force-range")
        assert "force-range" in collector.advice


def test_a_scale_that_falls_silent_within_a_press_is_called_so(tmp_path: Path) -> None:
    with weighed(tmp_path) as collector:
        fed(collector, [0.0] * 30 + [2.0] * 5, 1.0)
        for k in range(40):
            at_ns = round((4.5 + 0.1 * k) * 1e9)
            collector.on_frame(Frame(np.zeros((8, 8), np.uint8), at_ns / 1e9, arrived_ns=at_ns))
        assert "said nothing" in collector.advice
