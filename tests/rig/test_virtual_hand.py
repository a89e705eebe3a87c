"""Laws of the virtual hand: what it holds is what the sensor feels, and the same seed is the same hand."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, ManualClock, Pose
from palpate.core.sensor import for_live, sensor
from palpate.rig.virtual.virtual_hand import HandHabits, VirtualHand
from palpate.rig.virtual.virtual_world import Dent
from palpate.sensors.palm import fringe_view, palm_spec
from palpate.sensors.palm.palm_render import render_clean
from palpate.sensors.palm.palm_sensor import Palm

SENSORS = ("palm", "tactip", "nusense")


def felt(hand: VirtualHand, seconds: float) -> np.ndarray:
    """Time and true normal force, and the reading of the sensor without its bias [s, N, N]."""
    rows = []
    for _ in range(round(seconds * 50)):
        hand.clock.sleep(0.02)
        for one in hand.force.drain():
            rows.append((one.time_ns / 1e9, one.force_n[2] - 1.7))
    return np.array(rows)


@pytest.mark.parametrize("name", SENSORS)
def test_plateaus_hold_the_force_that_was_aimed_at_and_nothing_is_touched_between(name: str) -> None:
    hand = VirtualHand(name, seed=3, clock=ManualClock(), habits=HandHabits(slips=0.0))
    rows = felt(hand, 7.0)
    least, greatest = hand.force_range_n
    assert len(hand.world.presses) >= 2
    for press in hand.world.presses[:-1]:
        first, last = press.holds_s
        during = rows[(rows[:, 0] > first + 0.05) & (rows[:, 0] < last - 0.05), 1]
        assert least <= press.force_n <= greatest
        # The skin's height varies from press to press, so that force is not held to better than that.
        law = hand.world._skin.law
        slope = np.interp(press.force_n, law.force_n, np.gradient(law.force_n, law.depth_m))
        allowed = 0.05 * press.force_n + 4 * hand.world.variation.seating_m * slope + 0.1
        assert abs(np.mean(during) - press.force_n) < allowed
        air = rows[(rows[:, 0] > press.ends_s) & (rows[:, 0] < press.ends_s + 0.4), 1]
        assert abs(np.mean(air)) < 0.05
        assert press.ends_s + 0.5 <= hand.world.presses[-1].begins_s


def test_same_seed_is_the_same_hand_and_another_is_not() -> None:
    def presses(seed: int) -> tuple:
        hand = VirtualHand("tactip", seed=seed, clock=ManualClock())
        felt(hand, 6.0)
        return hand.world.presses

    assert presses(4) == presses(4)
    assert presses(4) != presses(5)


def test_tremor_lies_at_its_frequency_and_has_its_size() -> None:
    habits = HandHabits(hold_s=(4.0, 4.0), tremor=0.05, wander=0.0, slips=0.0, force_n=(8.0, 8.0))
    hand = VirtualHand("palm", seed=2, clock=ManualClock(), habits=habits)
    rows = felt(hand, 8.0)
    press = hand.world.presses[0]
    during = rows[(rows[:, 0] > press.holds_s[0]) & (rows[:, 0] < press.holds_s[1])]
    swing = during[:, 1] - during[:, 1].mean()
    assert swing.std() == pytest.approx(0.05 * 8.0, rel=0.05)
    spectrum = np.abs(np.fft.rfft(swing))
    assert np.fft.rfftfreq(len(swing), 1 / 200)[spectrum.argmax()] == pytest.approx(press.tremor_hz, abs=0.3)
    assert 8 <= press.tremor_hz <= 12


def test_slip_moves_the_contact_and_eases_the_force() -> None:
    hand = VirtualHand(
        "palm", seed=0, clock=ManualClock(), habits=HandHabits(slips=1.0, tremor=0.0, wander=0.0)
    )
    rows = felt(hand, 5.0)
    press = hand.world.presses[0]
    first, last = press.holds_s
    when = first + press.slip[0] * press.hold_s
    before = rows[(rows[:, 0] > first) & (rows[:, 0] < when), 1].mean()
    after = rows[(rows[:, 0] > when + 0.06) & (rows[:, 0] < last), 1].mean()
    assert 1 - after / before == pytest.approx(press.slip[3], abs=0.01)
    assert press.left_at != (press.x_m, press.y_m)


def test_known_weights_are_laid_on_without_tremor() -> None:
    hand = VirtualHand("palm", clock=ManualClock(), habits=HandHabits(weights_n=(2.0, 5.0)))
    felt(hand, 12.0)
    assert {press.force_n for press in hand.world.presses} <= {2.0, 5.0}
    assert all(press.tremor_n == press.wander_n == 0 for press in hand.world.presses)


def test_frames_show_the_hand_and_their_truth_is_the_sensors() -> None:
    hand = VirtualHand("tactip", seed=1, clock=ManualClock())
    rest = hand.camera.grab()[1].image.astype(float)
    most, deepest = 0.0, 0.0
    for _ in range(80):
        time_ns, frame = hand.camera.grab()
        truth = hand.truth(time_ns)
        change = float(np.abs(frame.image.astype(float) - rest).mean())
        most, deepest = (change, truth["true_force_N"]) if change > most else (most, deepest)
    assert most > 3
    assert deepest > hand.force_range_n[0] / 2


def test_live_pictures_of_the_palm_are_those_drawn_anew() -> None:
    live = for_live(sensor("palm"))
    for depth_mm in (0.72, 3.43):
        contact, next_one = (
            live.press(live.probe(live.default_probe), Pose(2e-3, 1e-3, 1e-3 * mm))
            for mm in (depth_mm, depth_mm + 0.05)
        )
        anew, mixed, other = (
            render_clean(contact, live.spec)[0],
            live._mixed(contact, live.spec)[0],
            live._mixed(next_one, live.spec)[0],
        )
        assert np.quantile(np.abs(mixed - anew), 0.99) < 0.004
        assert np.quantile(np.abs(other - anew), 0.99) > 0.03


def test_earlier_presses_are_told_while_others_add_to_them() -> None:
    hand, over = VirtualHand(sensor("tactip"), clock=ManualClock()), threading.Event()
    dent = Dent(0.0, 0.0, 0.0, (), 1e-3)
    world = hand.world

    def add() -> None:
        while not over.is_set():
            with world.lock:
                world._dents.append(dent)

    adding = threading.Thread(target=add)
    adding.start()
    try:
        for _ in range(2000):
            world.earlier(1.0)
    finally:
        over.set()
        adding.join()


def test_forces_beyond_the_skins_law_are_refused() -> None:
    with refused("force-range", InputError):
        VirtualHand("tactip", clock=ManualClock(), habits=HandHabits(force_n=(1.0, 50.0)))


def test_a_hand_that_feels_a_body_presses_it_head_on_to_where_bodies_are_compared():
    hand = VirtualHand("tactip", seed=3, clock=ManualClock(), indenter="S3=1.1")
    assert hand.world.specimen is not None
    hand.clock.sleep(8.0)
    hand.force.drain()
    press = hand.world.presses[0]
    assert 4.5 < press.force_n <= 5.0
    assert (press.x_m, press.y_m) == (0.0, 0.0)
    rigid = VirtualHand("tactip", seed=3, clock=ManualClock(), indenter="rigid")
    soft, hard = (
        float(np.interp(4.7, one.world._skin.law.force_n, one.world._skin.law.depth_m))
        for one in (hand, rigid)
    )
    assert soft - hard == pytest.approx(4.7 / 1.1e3, rel=0.02)  # by which a body of 1.1 N/mm gives way
    for one in (hand, rigid):
        one.close()
    with pytest.raises(InputError):
        VirtualHand("tactip", clock=ManualClock(), indenter="no such body")


def test_a_hand_that_drew_ahead_waits_for_no_picture_while_it_presses(monkeypatch):
    marched: list[float] = []
    march = fringe_view._marched

    def counted(spec, depth_m, *others):
        marched.append(depth_m)
        return march(spec, depth_m, *others)

    monkeypatch.setattr(fringe_view, "_marched", counted)
    small = palm_spec.cropped(palm_spec.preset("palm"), 16, "palm-of-this-test")
    palm = Palm(replace(small, rays_per_pixel=(1, 1)), level_m=0.4e-3)
    hand = VirtualHand(palm, seed=4, clock=ManualClock(), pressing=False)
    fringe_view.picture_of.cache_clear()
    hand.draw_ahead()
    drawn = len(marched)
    assert max(marched) >= hand.world.deepest_m > 2e-3
    hand.world.press(1.0)
    depths = []
    for _ in range(60):
        hand.clock.sleep(0.2)
        depths.append(hand.truth(hand.camera.grab()[0])["true_depth_mm"])
    assert len(marched) == drawn
    assert (np.array(depths) > 0.5).sum() > 10
    assert max(depths[:4]) == 0.0  # untouched for the second that was asked for
    fringe_view.picture_of.cache_clear()  # and without any of it every depth is waited for
    hand.camera.grab()
    hand.clock.sleep(1.0)
    for _ in range(20):
        hand.clock.sleep(0.2)
        hand.camera.grab()
    assert len(marched) > drawn
    hand.close()


def test_frames_drained_one_at_a_time_are_those_drained_at_once() -> None:
    at_once, singly = (VirtualHand("tactip", seed=5, clock=ManualClock()) for _ in range(2))
    for hand in (at_once, singly):
        hand.clock.sleep(2.3)
    whole = at_once.camera.drain()
    found = []
    while taken := singly.camera.drain(at_most=1):
        assert len(taken) == 1
        found += taken
    assert len(found) == len(whole) > 10
    for (stamp_ns, frame), (whole_ns, of_whole) in zip(found, whole, strict=True):
        assert stamp_ns == whole_ns
        assert np.array_equal(frame.image, of_whole.image)
