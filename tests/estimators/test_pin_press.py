"""One press from frames and force: what a good one gives, and that no bad one passes for it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core.errors import ImageError, InputError
from palpate.estimators.compliance.pin_press import follow_press
from palpate.sensors.tactip import tactip
from palpate.sensors.tactip.tactip_camera import rendered
from palpate.workflows.tactip_trials import record_press

RATE, EVERY = 200, 10


@pytest.fixture(scope="module")
def made():
    """One virtual trial on S1, rendered."""
    return record_press(tactip(), "S1=7.6", seed=11)


@pytest.fixture(scope="module")
def frames(made) -> list[np.ndarray]:
    return list(made.frames())


def watch(made, frames, **changed):
    given = {
        "force_n": made.raw_n,
        "frame_sample": made.frame_sample,
        "position_m": made.position_m,
        "time_s": made.time_s,
    } | changed
    return follow_press(frames, **given)


def test_a_good_press_is_followed_through_its_loading_part(made, frames) -> None:
    press = watch(made, frames)
    assert press.flaws == ()
    assert press.force_n[0] >= 0.5
    assert press.force_n[-1] > 4.9
    assert (np.diff(press.frame) == 1).all()
    assert_allclose(press.force_n, made.true_force_n[made.frame_sample[press.frame]], atol=0.06)
    assert_allclose(press.speed_m_s, made.sensor.spec.speed_m_s, rtol=1e-9)


def test_motion_is_what_the_markers_did(made, frames) -> None:
    press = watch(made, frames)
    (rest, _), (last, _) = (made.points_px(int(i)) for i in (0, press.frame[-1]))
    order = [int(np.argmin(np.hypot(*(rest - xy).T))) for xy in press.untouched_px]
    off = press.moved_px[-1] - (last - rest)[order]
    assert np.hypot(*off.T).max() < 0.2
    assert np.sqrt((off**2).mean()) < 0.05


def test_position_is_counted_from_contact_whatever_the_encoders_origin(made, frames) -> None:
    here, there = (watch(made, frames, position_m=made.position_m + x) for x in (0.0, 0.125))
    assert_allclose(here.position_m, there.position_m, atol=1e-12)
    assert 0 <= here.position_m[0] < made.sensor.spec.speed_m_s / made.sensor.spec.camera.rate_hz


def test_without_an_encoder_there_is_no_position_and_no_speed(made, frames) -> None:
    press = watch(made, frames, position_m=None)
    assert press.position_m is None
    assert np.isnan(press.speed_m_s)
    assert np.isnan(watch(made, frames, time_s=None).speed_m_s)


def test_a_spike_of_force_changes_nothing(made, frames) -> None:
    force = made.raw_n.copy()
    force[[40, 150]] += 30.0
    assert_allclose(watch(made, frames, force_n=force).force_n, watch(made, frames).force_n, atol=0.05)


def test_a_first_frame_that_is_touched_is_refused(made, frames) -> None:
    begin = int(np.argmax(made.true_force_n[made.frame_sample] > 0.3))
    late = made.frame_sample[begin]
    with refused("first-frame-touched", InputError):
        follow_press(frames[begin:], made.raw_n[late:], made.frame_sample[begin:] - late)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda force: force + 0.3, "first-frame-touched"),
        (lambda force: force / 20, "no-contact"),
        (lambda force: force[::-1].copy(), "not-loading"),
    ],
)
def test_a_force_of_no_press_is_refused(made, frames, change, code) -> None:
    with refused(code, InputError):
        watch(made, frames, force_n=change(made.raw_n))


def test_too_few_frames_or_fewer_than_in_the_table_are_refused(made, frames) -> None:
    for every in (5, len(frames)):
        with refused("too-few-frames", InputError):
            follow_press(frames[::every], made.raw_n, made.frame_sample[::every])
    with pytest.raises(InputError, match="no frame"):
        follow_press([], made.raw_n, made.frame_sample)
    with refused("frames-differ", InputError):
        watch(made, frames[:-8])


def test_a_saturated_force_is_flagged(made, frames) -> None:
    (flaw,) = watch(made, frames, force_n=np.minimum(made.raw_n, 3.0)).flaws
    assert "3 N" in flaw


def test_pins_that_wander_before_contact_are_flagged(made, frames) -> None:
    """The camera or the sensor moves: every pin by 0.4 px a frame before contact."""
    touched = int(np.argmax(made.true_force_n[made.frame_sample] > 0))
    moving = []
    for i in range(len(frames)):
        xy, radius = made.points_px(i)
        off = 0.4 * min(i, touched)
        moving.append(rendered(xy + off, radius, made.sensor.spec.camera, np.random.default_rng(i)))
    (flaw,) = watch(made, moving).flaws
    assert "pins wander" in flaw


def test_lost_pins_are_refused_and_a_few_are_left_out(made, frames) -> None:
    dark = [frame.copy() for frame in frames]
    for frame in dark[-6:]:
        frame[:, :70] = 18  # a strip at the side goes dark: about a tenth of the pins
    press = watch(made, dark)
    lost = ~np.isfinite(press.moved_px).all(axis=(0, 2))
    assert 0 < lost.mean() < 0.2
    for frame in dark[-6:]:
        frame[:, :150] = 18
    with refused("pins-lost", InputError):
        watch(made, dark)


def test_images_without_pins_are_refused(made, frames) -> None:
    with pytest.raises(ImageError, match="pins"):
        watch(made, [np.full_like(frame, 30) for frame in frames])
    with pytest.raises(ImageError, match="8-bit grey"):
        watch(made, [frame.astype(np.float64) for frame in frames])
