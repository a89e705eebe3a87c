"""A Net F/T box that sends slower than its page states is slow; one whose records are held back is late.

Over real sockets and the driver. A busy computer delays records as well, so each bound here is on what
the fault makes, and the control, a box in time, may be busy once and is then listened to again.
"""

import time

import pytest
from tests.fakes.netft_box import FakeNetFT, FakePage

from palpate.core import Wrench
from palpate.devices import ForceBias, Limits, Reason, Tripped
from palpate.devices.force_trust import ForceMonitor, Phase, name_fault
from palpate.rig.real.netft.netft_sensor import NetFT, NetFTSettings
from palpate.rig.virtual.virtual_bench import TRAVEL

HZ = 200.0
PATIENCE_S = 30.0
TRIES = 10  # of a healthy box on a busy computer
AIR = 300  # samples of the air: some that a busy computer sends at once then change the rate by little


def noisy_box() -> FakeNetFT:
    """A box that states `HZ`; its noise is a count's rounding of a force that never stands still."""
    return FakeNetFT(
        force=lambda t: (0.3, -0.2, 1.7 + 0.01 * ((t * 7919.0) % 1.0)), page=FakePage(rate_hz=HZ)
    )


def connected(box: FakeNetFT) -> NetFT:
    ports = {"rdt_port": box.rdt_port, "http_port": box.http_port}
    return NetFT(box.host, NetFTSettings(**ports, silence_s=20.0, start_wait_s=5.0))


def samples(sensor: NetFT, count: int) -> list[Wrench]:
    """The next samples, as many as are asked for."""
    heard, end = [], time.monotonic() + PATIENCE_S
    sensor.drain()
    while len(heard) < count:
        assert time.monotonic() < end, "waited in vain"
        heard += sensor.drain()
        time.sleep(5e-3)
    return heard


def taught(sensor: NetFT, count: int = AIR) -> ForceMonitor:
    """A monitor that learnt the air from the sensor at the rate that it states."""
    bias, air = ForceBias(), samples(sensor, count)
    monitor = ForceMonitor(bias, Limits(TRAVEL.least_m, TRAVEL.greatest_m), TRAVEL)
    bias.measure(air)
    monitor.learn_air(air, sensor.rate_hz)
    return monitor


def taught_in_time(sensor: NetFT) -> ForceMonitor:
    for _ in range(TRIES):
        try:
            return taught(sensor)
        except Tripped as busy:
            last = busy
    raise last


@pytest.mark.parametrize(("sent_hz", "heard_s"), [(0.5 * HZ, 0.0), (0.2 * HZ, 3.0)])
@pytest.mark.cases(1)
def test_a_box_that_sends_slower_than_its_page_states_is_named_slow(sent_hz: float, heard_s: float) -> None:
    with noisy_box() as box:
        box.sent_hz = sent_hz
        with connected(box) as sensor:
            time.sleep(heard_s)
            with pytest.raises(Tripped, match=f"states {HZ:g}") as caught:
                taught(sensor, 30)
        assert caught.value.reason is Reason.FORCE_SLOW


def test_records_that_are_held_back_are_named_late_and_none_is_lost() -> None:
    hold_s = 0.5
    with noisy_box() as box, connected(box) as sensor:
        monitor = taught_in_time(sensor)  # the negative control of the law above
        lost = sensor.counts.lost
        monitor.begin(Phase.DOWN, 2e-3, 1e-3, *[time.monotonic_ns()] * 2)
        box.hold_s = hold_s
        end = time.monotonic() + PATIENCE_S
        age_s = 0.0
        while age_s <= monitor.oldest_s:
            assert time.monotonic() < end, "records that are held back never grew old"
            age_s = (time.monotonic_ns() - sensor.latest().time_ns) / 1e9
            time.sleep(1e-3)
        doubt = monitor.gap(age_s)
        sensor.drain()
        begun = time.monotonic()
        heard: list[Wrench] = []
        while time.monotonic() - begun < 4 * hold_s:
            heard += sensor.drain()
            time.sleep(5e-3)
        air = monitor.air
        assert air is not None
        reason, words = name_fault(doubt, heard, air, ForceBias(), time.monotonic() - begun)
        assert reason is Reason.FORCE_LATE, words
        assert sensor.counts.lost == lost
