"""Presses cut out of what comes live: the loading of each, its frames laid beside its samples of force."""

from __future__ import annotations

import numpy as np
import pytest
from tests.virtual_presses import KAPPA_N_M, references, seen

from palpate.calibration.compliance.compliance_calibration import calibrate_compliance
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.core import Frame, InputError
from palpate.core.device_protocols import Wrench
from palpate.sensing.streaming.live_presses import PressReader, compliance_of
from palpate.sensors.tactip import tactip
from palpate.workflows.tactip_trials import record_press, specimens_at

BIAS_N = 1.5


def hand_over(reader: PressReader, force_at, end_s: float, *, frame_hz: float = 30.0) -> None:
    """Frames and forces of a time, in the order in which they come; a frame shows its time in ms."""
    frames = [(i / frame_hz, "frame") for i in range(int(end_s * frame_hz))]
    samples = [(i / 200.0, "sample") for i in range(int(end_s * 200))]
    for at_s, kind in sorted([*frames, *samples]):
        if kind == "sample":
            force = BIAS_N + force_at(at_s)
            reader.on_force([Wrench(round(at_s * 1e9), (0.0, 0.0, force))])
        else:
            image = np.full((1, 2), round(1e3 * at_s) % 251, np.uint8)
            reader.on_frame(Frame(image, at_s), None)


def ramp(begin_s: float, peak_s: float, peak_n: float, end_s: float):
    def force(at_s: float) -> float:
        return float(np.interp(at_s, [begin_s, peak_s, end_s], [0.0, peak_n, 0.0]))

    return force


class Given:
    """Reads nothing, and keeps what it was given."""

    def __init__(self) -> None:
        self.presses = []

    def __call__(self, frames, table, name):
        self.presses.append((np.array([frame[0, 0] for frame in frames]), table, name))
        return ()


def test_the_loading_of_each_press_is_read_and_nothing_after_its_peak() -> None:
    given, told = Given(), []
    first, second = ramp(1.0, 2.0, 4.0, 3.0), ramp(4.0, 5.0, 6.0, 5.5)
    with PressReader(given, told.append) as reader:
        hand_over(reader, lambda at_s: first(at_s) + second(at_s), 6.5)
        assert reader.wait(2, 5.0)
    assert [(one.number, one.why) for one in told] == [(1, ""), (2, "")]
    assert [one.force_n for one in told] == pytest.approx([4.0, 6.0], abs=0.03)
    for (shown_ms, table, _), (begin_s, peak_s) in zip(given.presses, ((1.0, 2.0), (4.0, 5.0)), strict=True):
        assert table.force_n[0] == pytest.approx(0.0, abs=0.01)
        assert (np.diff(table.force_n) > -1e-9).all()
        assert table.time_s[-1] == pytest.approx(peak_s - begin_s + 0.4, abs=0.05)
        # Every frame belongs to the sample of its own time.
        first_ms = 1e3 * (peak_s - table.time_s[-1])
        of_samples_ms = (first_ms + 1e3 * table.time_s[table.frame_sample]) % 251
        apart = np.abs((of_samples_ms - shown_ms + 125.5) % 251 - 125.5)
        assert apart.max() <= 3.6  # half a sample, and rounding
        assert len(shown_ms) == pytest.approx(30 * table.time_s[-1], abs=2)


@pytest.mark.parametrize(("rate_hz", "newtons_a_second"), [(10.0, 0.6), (1000.0, 0.15)])
def test_a_slow_press_is_no_drift_of_the_bias_at_any_rate_of_samples(
    rate_hz: float, newtons_a_second: float
) -> None:
    told = []
    peak_s = 3.0 + 2.0 / newtons_a_second
    at_s = np.arange(0.0, peak_s + 1.5, 1 / rate_hz)
    drifting_n = BIAS_N + 0.002 * at_s
    force_n = np.where(at_s < peak_s, np.clip(newtons_a_second * (at_s - 3.0), 0.0, None), 0.0)
    with PressReader(Given(), told.append) as reader:
        raw_n = (drifting_n + force_n).tolist()
        reader.on_force(
            [Wrench(round(1e9 * t), (0.0, 0.0, n)) for t, n in zip(at_s.tolist(), raw_n, strict=True)]
        )
        reader.wait(1, 1.0)
    (press,) = told
    # The bias is the median of five seconds: it lags behind a drift by up to half of them and the press.
    assert press.force_n == pytest.approx(2.0, abs=0.06 + 0.002 * (peak_s - 3.0 + 2.5))


def test_a_press_too_quick_to_film_says_so_and_the_next_is_read() -> None:
    given, told = Given(), []
    quick, slow = ramp(1.0, 1.05, 4.0, 1.1), ramp(3.0, 4.0, 4.0, 4.5)
    with PressReader(given, told.append) as reader:
        hand_over(reader, lambda at_s: quick(at_s) + slow(at_s), 5.5, frame_hz=10.0)
        assert reader.wait(2, 5.0)
    assert told[0].code == "too-few-frames"
    assert told[1].code == ""
    assert len(given.presses) == 1


def test_a_press_that_is_refused_says_why_and_ends_nothing() -> None:
    def refuse(frames, table, name):
        raise InputError("too few pins", code="too-few-pins")

    told = []
    with PressReader(refuse, told.append) as reader:
        hand_over(reader, ramp(1.0, 2.0, 4.0, 3.0), 4.0)
        assert reader.wait(1, 5.0)
    assert told[0].code == "too-few-pins"
    assert told[0].to_dict()["readings"] == []


@pytest.mark.slow
def test_a_press_that_comes_live_reads_as_one_that_was_recorded() -> None:
    spec = tactip()
    specimens = specimens_at(spec, KAPPA_N_M)
    calibration = calibrate_compliance(references(spec, specimens, 2, 7000, rendered=False), note="virtual")
    made = record_press(spec, specimens["S2"], 9200)
    recorded = read_touch(calibration, [seen(made).press]).stiffness
    told, frames = [], list(made.frames())
    rest_s = made.time_s[0] - np.arange(1, 121)[::-1] / 200
    after_s = made.time_s[-1] + np.arange(1, 121) / 200
    with PressReader(compliance_of(calibration), told.append) as reader:
        forces = [*((at_s, made.raw_n[0]) for at_s in rest_s), *zip(made.time_s, made.raw_n, strict=True)]
        forces += [(at_s, made.raw_n[0]) for at_s in after_s]
        filmed = dict(zip(made.frame_sample.tolist(), frames, strict=True))
        for k, (at_s, force) in enumerate(forces):
            image = frames[0] if k < len(rest_s) and k % 10 == 0 else filmed.get(k - len(rest_s))
            if image is not None:
                reader.on_frame(Frame(image, 10.0 + at_s), None)
            reader.on_force([Wrench(round((10.0 + at_s) * 1e9), (0.0, 0.0, float(force)))])
        assert reader.wait(1, 120.0)
    (press,) = told
    assert press.why == ""
    assert press.readings[0].quantity == recorded.quantity
    assert press.readings[0].value == pytest.approx(recorded.value, rel=0.02)
