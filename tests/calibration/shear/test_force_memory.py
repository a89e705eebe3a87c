"""Laws of the memory in a force calibration: known branches come back, and a lost history is not made up."""

import numpy as np
import pytest
from tests.virtual_shears import VirtualPad, cycles, remembered

from palpate.calibration.shear import ForceFollower, TouchCues, calibrate_shear
from palpate.calibration.shear.force_law import MAX_GAP_S, MemoryTrace, fit_remembering, follow_memory

PAD = VirtualPad()
SPEC = PAD.sensor.spec
FAST_M_S = 1.5e-3


def test_a_step_fades_with_each_time():
    """After a step of 2 N, held, a branch of T holds 2 exp(-t/T) N."""
    trace = MemoryTrace(np.array([0.5, 3.0]))
    assert trace.step(0.0, 0.0).tolist() == [0.0, 0.0]
    trace.step(1e-6, 2.0)
    for k in range(1, 11):
        held = trace.step(0.1 * k, 2.0)
    assert held == pytest.approx(2 * np.exp(-1.0 / np.array([0.5, 3.0])), rel=1e-4)


def test_unloading_remembers_the_other_way():
    trace = MemoryTrace(np.array([1.0]))
    ramp = [*range(11), *range(9, -1, -1)]
    held = [float(trace.step(0.1 * k, 0.5 * n)[0]) for k, n in enumerate(ramp)]
    assert max(held[:11]) == held[10] > 0
    assert held[-1] < 0


def test_a_history_that_is_not_known_is_not_made_up():
    """Unknown at first under contact, and after a gap or a step back in time, until the skin is free."""
    trace = MemoryTrace(np.array([1.0]))
    assert np.isnan(trace.step(0.0, 3.0)).all()
    assert np.isnan(trace.step(0.1, 3.0)).all()
    assert (trace.step(0.2, 0.0) == 0).all()
    assert (trace.step(0.3, 1.0) > 0).all()
    assert np.isnan(trace.step(0.4 + MAX_GAP_S, 1.0)).all()
    trace.step(2.0, 0.0)
    assert np.isnan(trace.step(1.9, 1.0)).all()


@pytest.fixture(scope="module")
def pressed():
    return cycles(PAD, 14, 1, speed_m_s=FAST_M_S)


@pytest.fixture(scope="module")
def calibration(pressed):
    return calibrate_shear(pressed, PAD.reference, SPEC.lens, SPEC.camera_m, law="placed", hysteresis=True)


@pytest.mark.slow
def test_memory_halves_the_error_of_loading_and_unloading(calibration):
    """Within 0.25 N in the mean on unseen cycles, with the history; twice that error without."""
    unseen = cycles(PAD, 5, 2, speed_m_s=FAST_M_S)
    memory, _ = follow_memory(calibration.remembering, unseen.cues, unseen.time_s, unseen.press)
    off, width = {}, {}
    for known in (True, False):
        readings = [
            calibration.read(cues, rows if known else None)
            for cues, rows in zip(unseen.cues, memory, strict=True)
        ]
        told = [(r, f) for r, f in zip(readings, unseen.force_n, strict=True) if r.valid]
        off[known] = np.mean([abs(r.value - f) for r, f in told])
        width[known] = np.mean([r.high - r.low for r, _ in told])
        assert np.mean([r.contains(f) for r, f in told]) > 0.8
    assert off[True] < 0.12
    assert off[True] < 0.6 * off[False]
    assert width[True] < 0.8 * width[False]


@pytest.mark.slow
def test_places_in_a_row_of_images_are_no_seconds(calibration):
    """Without a clock a frame has one force, whatever stood before it, and the interval of single frames."""
    marks = PAD.marks(PAD.contact("round", 0.0, 0.0, 1.2e-3), np.random.default_rng(7))
    alone = ForceFollower(calibration).read(marks, 0.0)
    assert alone.valid
    for clocked in (False, True):
        follower = ForceFollower(calibration)
        follower.read(PAD.reference, 0.0, clocked=clocked)
        after = [follower.read(marks, float(i), clocked=clocked) for i in (1, 2)]
        same = [(r.value, r.low, r.high) == (alone.value, alone.low, alone.high) for r in after]
        assert same == [not clocked] * 2
        assert [r.time_s for r in after] == [1.0, 2.0]  # still names the frame's place


def loaded_and_held(shares):
    """Cues whose gamma is a tenth of the elastic force; a ramp of 1 s, 6 s held, and up again."""
    time = np.arange(-0.2, 9.0, 0.05)
    elastic = np.interp(time, [0.0, 1.0, 7.0, 8.0], [0.0, 6.0, 6.0, 0.0])
    fine = np.arange(-0.2, 9.0, 0.001)
    dense = np.interp(fine, time, elastic)
    force = dense + sum(share * remembered(dense, 0.001, T) for T, share in shares.items())
    touched = [TouchCues(0.1 * n, 1.0, 1.0, 1.0, 0.0, 0.0, int(n > 0), 1e-3) for n in elastic]
    return touched, np.interp(time, fine, force), time


def test_branches_come_back():
    cues, force, time = loaded_and_held({0.3: 0.10, 4.0: 0.08})
    used = np.array([c.contacts > 0 for c in cues])
    line = fit_remembering("published", cues, force, used, time, np.full(len(cues), "one"))
    assert line.weights == pytest.approx([10.0, 0.0], abs=0.1)
    assert dict(zip(line.memory_s, line.memory_share, strict=True)) == pytest.approx(
        {0.1: 0.0, 0.3: 0.10, 1.0: 0.0, 4.0: 0.08}, abs=0.02
    )


def test_a_skin_without_memory_is_given_none():
    """The control."""
    cues, force, time = loaded_and_held({})
    used = np.array([c.contacts > 0 for c in cues])
    line = fit_remembering("published", cues, force, used, time, np.full(len(cues), "one"))
    assert line.memory_share.sum() < 1e-3
