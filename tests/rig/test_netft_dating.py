"""A Net F/T's samples are as old as its own numbers say; equal counts under running numbers are no force."""

import struct

import numpy as np
import pytest
from tests.fakes.netft_box import FakePage

from palpate.core import NS_PER_S, Wrench
from palpate.devices import ForceBias, Limits, Reason, Tripped
from palpate.devices.force_trust import ForceMonitor
from palpate.rig.real.netft.netft_calibration import calibration
from palpate.rig.real.netft.netft_sensor import Samples
from palpate.rig.virtual.virtual_bench import TRAVEL

HZ = 500.0
HOLD_S = 0.08


def stream(
    rng, count: int, hold_from_s: float, frozen_from: int = 1 << 30, first: int = 2**32 - 700
) -> list[Wrench]:
    """Samples of records that wrap in their numbers, held back from a time on, frozen in their counts."""
    samples = Samples(calibration(FakePage().xml()), (330.0, 330.0, 990.0), 1.0, 0, rate_hz=HZ)
    taken: list[Wrench] = []
    counts = (0,) * 6
    for i in range(count):
        sent_s = i / HZ
        arrival_s = sent_s if sent_s < hold_from_s else np.ceil(sent_s / HOLD_S) * HOLD_S
        counts = tuple(rng.integers(-9000, 9000, 6).tolist()) if i < frozen_from else counts
        record = struct.pack(">III6i", (first + i) % 2**32, 1 + i, 0, *counts)
        taken += samples.take(record, round((1.0 + arrival_s) * NS_PER_S))
    return taken


def test_records_that_were_held_back_are_dated_by_their_numbers(rng) -> None:
    taken = stream(rng, 4000, hold_from_s=4.0)
    assert len(taken) == 4000, "none is lost where the numbers wrap"
    dated = np.array([one.time_ns for one in taken]) / NS_PER_S - 1.0
    # The least delay is forgotten by 1 % of the time since it was seen: less than 1 ms from burst to burst.
    assert np.abs(dated - np.arange(4000) / HZ).max() < 2e-3
    assert (np.diff(dated) >= 0).all()


def test_equal_counts_under_running_numbers_are_not_believed(rng) -> None:
    taken = stream(rng, 400, hold_from_s=9.0, frozen_from=200)
    bias = ForceBias()
    monitor = ForceMonitor(bias, Limits(TRAVEL.least_m, TRAVEL.greatest_m), TRAVEL)
    bias.measure(taken[:150])
    monitor.learn_air(taken[:150], HZ)
    doubts = [(i, doubt) for i, one in enumerate(taken[150:], 150) if (doubt := monitor.take(one))]
    first, doubt = doubts[0]
    assert doubt.kind == "repeats"
    assert 199 < first < 199 + 12, "soon after the first that is repeated, and never before"
    with pytest.raises(Tripped) as caught:
        monitor.learn_air(taken[250:], HZ)
    assert caught.value.reason is Reason.FORCE_STUCK
