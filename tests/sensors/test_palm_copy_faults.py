"""A copy's estimate on palms with faults: each part against its closed form or against a brute solution."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.core import Pose
from palpate.estimators.unit_fit import KnownRow, Widening, standardised, widening_of
from palpate.optics.image_chain import AutoExposure
from palpate.sensors.palm.copies.copy_estimate import log_force, picture_slopes, told_by, unsure_constants
from palpate.sensors.palm.copies.palm_copy import AT, LOCAL, TERMS, PalmCopy, designed_copy
from palpate.sensors.palm.copies.press_picture import (
    backdrop_of,
    exposure_change,
    pictured,
    shown,
)
from palpate.sensors.palm.membrane_faults import Glare, MirrorDirt, UnevenGel, modulus_ratio, thickness_at
from palpate.sensors.palm.palm_press import press
from palpate.sensors.palm.palm_render import housed, render, render_clean
from palpate.sensors.palm.palm_spec import palm, scaled_down

DESIGN = scaled_down(palm(), 20, "tiny")
AT_REST, PRESSED = Pose(0.0, 0.0, -1e-3), Pose(3e-3, -2e-3, 2.5e-3)


def local_of(pose: Pose, **others: float) -> np.ndarray:
    own = dict.fromkeys(LOCAL, 0.0) | {"x_m": pose.x_m, "y_m": pose.y_m, "log_depth": math.log(pose.depth_m)}
    return np.array(list((own | others).values()))


def with_terms(**terms: float) -> PalmCopy:
    known = designed_copy(DESIGN)
    values = known.terms.copy()
    for name, value in terms.items():
        values[AT[name]] = value
    return replace(known, terms=values)


def lights(spec, pose):
    frame = housed(render_clean(press(spec, pose), spec, exact=True), spec)
    return frame[spec.fringes.window], frame[spec.mirror.window]


def test_the_housing_beside_both_regions_tells_a_frame_s_own_exposure() -> None:
    rng = np.random.default_rng(0)
    deep, rest = (press(DESIGN, pose) for pose in (replace_depth(PRESSED, 4e-3), AT_REST))
    for auto, steps in ((None, 0), (AutoExposure(0.02, max_stops=1 / 3), None)):
        spec = replace(DESIGN, auto_exposure=auto)
        images = [render(one, spec, rng).image for one in (deep, rest)]
        plain = [housed(render_clean(one, DESIGN), DESIGN) for one in (deep, rest)]
        gains = [1.0 if auto is None else auto.gain(one) for one in plain]
        found = exposure_change(spec, *images)
        if steps == 0:
            assert found == 1.0
        else:
            assert gains[0] < gains[1]  # fringes are bright, so that a press is exposed less
            assert math.log(found) == pytest.approx(math.log(gains[0] / gains[1]), abs=0.02)


def replace_depth(pose: Pose, depth_m: float) -> Pose:
    return Pose(pose.x_m, pose.y_m, depth_m)


def test_behind_what_the_untouched_frame_shows_a_dirty_glaring_palm_is_drawn_as_it_looks() -> None:
    dirty = replace(DESIGN, dirt=MirrorDirt(12, texture=0.03, seed=1), glare=Glare(2, peak=0.05, seed=5))
    known = with_terms(blur_px=0.0)
    hanging = [Pose(x, y, -1e-3) for x, y in ((PRESSED.x_m, PRESSED.y_m), (-9e-3, 5e-3))]
    backdrop = backdrop_of(known, [lights(dirty, one) for one in hanging], [(p.x_m, p.y_m) for p in hanging])
    truth = pictured(replace(known, spec=dirty), PRESSED, exact=True)
    behind, bare = (shown(known, local_of(PRESSED), one) for one in (backdrop, None))
    off = [float(np.sqrt(np.mean((one - truth) ** 2))) for one in (behind, bare)]
    assert off[0] < 0.003
    assert off[1] > 4 * off[0]


def test_a_press_s_own_unknowns_draw_an_uneven_membrane_at_its_place() -> None:
    uneven = replace(DESIGN, gel=UnevenGel(0.05, 0.01, seed=2))
    known = with_terms(blur_px=0.0)
    harder = math.log(modulus_ratio(uneven, PRESSED.x_m, PRESSED.y_m))
    thicker = math.log(thickness_at(uneven, PRESSED.x_m, PRESSED.y_m) / DESIGN.thickness_m)
    local = local_of(PRESSED, harder=harder, thicker=thicker)
    truth = pictured(replace(known, spec=uneven), PRESSED, exact=True)
    assert_allclose(shown(known, local, None), truth, atol=1e-5)
    assert np.abs(shown(known, local_of(PRESSED), None) - truth).max() > 5e-3
    assert math.exp(log_force(known, local)[0]) == pytest.approx(press(uneven, PRESSED).force_n, rel=1e-3)


@pytest.mark.parametrize("thickness", [-0.04, 0.03])
def test_a_copy_s_force_is_its_own_spec_s_and_its_slopes_are_differences(thickness: float) -> None:
    known = with_terms(modulus=0.1, product=0.05, thickness=thickness, harder_across=0.04, harder_along=-0.03)
    local = local_of(PRESSED, harder=0.02)
    force, slopes = log_force(known, local)
    tilt = (0.04 * PRESSED.x_m - 0.03 * PRESSED.y_m) / DESIGN.radius_m + 0.02
    assert force - tilt == pytest.approx(
        math.log(press(replace(known.looks, youngs_modulus_pa=known.modulus_pa), PRESSED).force_n), abs=1e-3
    )
    for k, slope in enumerate(slopes):
        step = 1e-5 * (np.arange(len(slopes)) == k)
        own, of_copy = step[len(TERMS) :], step[: len(TERMS)]
        ends = [
            log_force(replace(known, terms=known.terms + s * of_copy), local + s * own)[0] for s in (1, -1)
        ]
        assert slope == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=0.02, abs=1e-4)


def test_slopes_of_a_picture_are_differences_of_exact_ones() -> None:
    """Within what the mirror's sampling at points changes them by; a wrong sign or unit breaks it."""
    known, local = with_terms(residual_along=0.004), local_of(PRESSED)
    J = picture_slopes(known, local, None)
    steps = {
        "product": 0.02, "lamp": 0.02, "polariser_rad": 5e-3, "elevation_rad": 5e-3, "mirror_down_px": 0.3,
        "fringes_across_px": 0.2, "fringes_down_px": 0.2, "fringes_turn_rad": 0.01, "fringes_scale": 0.01,
        "mirror_turn_rad": 0.01, "thickness": 0.01, "residual_along": 0.01, "residual_aside": 0.01,
        "residual_along_01": 0.01, "residual_along_20": 0.01, "residual_aside_11": 0.01,
    }  # fmt: skip
    for name, step in steps.items():
        off = step * (np.arange(len(TERMS)) == AT[name])
        moved = [shown(replace(known, terms=known.terms + s * off), local, None) for s in (1, -1)]
        want = (moved[0] - moved[1]) / (2 * step)
        got = J[:, AT[name]]
        alike = got @ want / np.linalg.norm(want) ** 2  # 1 but for edges that jump from pixel to pixel
        assert 0.8 < alike < 1.25, name
    assert not J[:, AT["modulus"]].any()


def moved(known: PalmCopy, local: np.ndarray, share: float, **steps: float) -> tuple[PalmCopy, np.ndarray]:
    """A copy and a press's unknowns, a share of these steps away."""
    of_copy = np.array([steps.get(name, 0.0) for name in TERMS])
    own = np.array([steps.get(name, 0.0) if name not in TERMS else 0.0 for name in LOCAL])
    return replace(known, terms=known.terms + share * of_copy), local + share * own


def linear_presses(rng: np.random.Generator, count: int, scale: float):
    """Two terms and one unknown a press, all linear; known forces err by `scale` times what is said."""
    size, truth = 2 + count, rng.standard_normal(2 + count)
    H, rows, seen = np.eye(2 + count) * 1e-6, [], []
    for i in range(count):
        for _ in range(8):
            J = np.zeros(size)
            J[[0, 1, 2 + i]] = rng.standard_normal(3)
            seen.append((J, J @ truth + 0.3 * rng.standard_normal(), 1 / 0.3**2))
        J = np.zeros(size)
        J[[0, 2 + i]] = 1.0
        rows.append((J, J @ truth + 0.1 * scale * rng.standard_normal(), 1 / 0.1**2, i))
    every = seen + [row[:3] for row in rows]
    H = H + sum(w * np.outer(J, J) for J, _, w in every)
    at = np.linalg.solve(H, sum(w * J * y for J, y, w in every))
    known = [KnownRow(J, y - J @ at, w, i, True) for J, y, w, i in rows]
    return H, known, seen, rows


def test_a_held_out_press_is_read_as_a_fit_without_its_known_force_reads_it() -> None:
    H, known, seen, rows = linear_presses(np.random.default_rng(1), 4, 1.0)
    found = standardised(H, np.zeros_like(H), known, [2, 3, 4, 5])
    for i in range(4):
        every = seen + [row[:3] for row in rows if row[3] != i]
        alone = np.eye(6) * 1e-6 + sum(w * np.outer(J, J) for J, _, w in every)
        at = np.linalg.solve(alone, sum(w * J * y for J, y, w in every))
        J, y, w, _ = rows[i]
        want = (y - J @ at) / math.sqrt(J @ np.linalg.solve(alone, J) + 1 / w)
        assert found["force"][i] == pytest.approx(want, abs=1e-6)


def test_intervals_are_widened_where_held_out_presses_miss_and_stay_where_they_do_not() -> None:
    rng = np.random.default_rng(2)
    found = {}
    for scale in (1.0, 10.0):
        factors = []
        for _ in range(30):
            H, known, _, _ = linear_presses(rng, 6, scale)
            errors = standardised(H, np.zeros_like(H), known, list(range(2, 8)))
            factors.append(widening_of(errors, 6).force)
        found[scale] = float(np.sqrt(np.mean(np.square(factors))))
    assert 1.0 <= found[1.0] < 1.2
    assert found[10.0] > 2.0
    assert widening_of({"place": [9.0], "depth": [], "force": [9.0]}, 1) == Widening()


def test_constants_that_are_known_well_enough_are_not_named() -> None:
    known = designed_copy(DESIGN, modulus_share=0.05, coefficient_share=0.005)
    assert unsure_constants(replace(known, covariance=0.1 * known.covariance)) == ()


@pytest.mark.slow
def test_a_modulus_that_thickness_hides_is_named_with_the_press_that_would_tell_it() -> None:
    known = designed_copy(DESIGN, modulus_share=0.05, coefficient_share=0.005)
    hidden = known.covariance.copy()
    k = AT["thickness"]
    hidden[k, k] = 0.02**2
    hidden[0, k] = hidden[k, 0] = 0.9 * 0.05 * 0.02
    copy = replace(known, covariance=hidden)
    (unsure,) = unsure_constants(copy)
    assert (unsure.constant, unsure.fault) == ("modulus", "thickness")
    assert unsure.half_share == pytest.approx(1.645 * 0.05)
    assert unsure.owed == pytest.approx(0.81)
    assert unsure.then_share < 0.8 * unsure.half_share
    pose = Pose(unsure.x_m, unsure.y_m, unsure.depth_m)
    after = told_by(copy, local_of(pose))
    assert unsure.then_share == pytest.approx(1.645 * math.sqrt(after[0, 0]))
