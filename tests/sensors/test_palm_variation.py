"""Copies of a palm, temperature, and the lens in its frame."""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from tests.refusals import refused

from palpate.core import Pose, RangeError
from palpate.optics.image_chain import ImageChain
from palpate.sensors import palm
from palpate.sensors.palm import fringe_orders
from palpate.sensors.palm.fringe_orders import contact_summary
from palpate.sensors.palm.palm_variation import ROOM_K, CopySpread, drawn_palm, warmed

SPEC = palm.debug()
NOWHERE = CopySpread(0, 0, 0, 0, 0, 0, 0, 0, 0, (0, 0), 0, (95, 95))


def frame(spec, seed=0):
    return palm.render(palm.press(spec, Pose(2e-3, 1e-3, 2e-3)), spec, np.random.default_rng(seed)).image


def test_copies_differ_by_the_stated_spread_and_by_nothing_else(rng) -> None:
    copies = [drawn_palm(SPEC, rng) for _ in range(400)]
    s = CopySpread()
    for value, spread in (
        (lambda c: np.log(c.youngs_modulus_pa / SPEC.youngs_modulus_pa), s.modulus_share),
        (lambda c: np.log(c.stress_optic.coefficient_per_pa / 1e-9), s.coefficient_share),
        (lambda c: c.polariser_rad - SPEC.polariser_rad, s.polariser_rad),
        (lambda c: c.mirror.middle_px[1] - SPEC.mirror.middle_px[1], s.region_px),
    ):
        drawn = np.array([value(one) for one in copies])
        assert_allclose(drawn.std(), spread, rtol=0.1)
        assert abs(drawn.mean()) < 4 * spread / np.sqrt(400)
    E, C = (np.array([c.youngs_modulus_pa for c in copies]),
            np.array([c.stress_optic.coefficient_per_pa for c in copies]))  # fmt: skip
    assert abs(np.corrcoef(np.log(E), np.log(C))[0, 1]) < 0.15
    assert drawn_palm(SPEC, rng, NOWHERE) == replace(SPEC, rim="applied", chain=ImageChain(jpeg_quality=95))


def test_warmth_changes_the_force_and_not_the_picture(monkeypatch) -> None:
    monkeypatch.setattr(fringe_orders, "edge_on", partial(fringe_orders.edge_on, points=31))
    warm = warmed(SPEC, ROOM_K + 29.6)
    cold_press, warm_press = (palm.press(one, Pose(0.0, 0.0, 2e-3)) for one in (SPEC, warm))
    assert_allclose(warm_press.force_n / cold_press.force_n, 1.1)
    assert_array_equal(frame(warm), frame(SPEC))
    orders = [contact_summary(p, s)["fringe_order_max"] for p, s in ((cold_press, SPEC), (warm_press, warm))]
    assert_allclose(orders[1], orders[0])
    with refused("temperature-range", RangeError):
        warmed(SPEC, 400.0)


def test_a_lens_blurs_the_frame_before_the_camera_adds_its_noise() -> None:
    """Edges soften; noise between neighbours does not."""
    soft = replace(SPEC, chain=ImageChain(blur_px=1.5))
    sharp_frames, soft_frames = (
        np.stack([frame(s, k) for k in range(12)]).astype(float) for s in (SPEC, soft)
    )
    steepest = [np.abs(np.diff(f.mean(axis=0), axis=1)).max() for f in (sharp_frames, soft_frames)]
    assert steepest[1] < 0.6 * steepest[0]
    noise = [f.std(axis=0).mean() for f in (sharp_frames, soft_frames)]
    assert_allclose(noise[1], noise[0], rtol=0.1)
