"""NUSense as it is drawn live, between presses that are solved once: beside each press solved anew."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import palpate
from palpate.core import Contact, Pose, PressHistory
from palpate.core.sensor import for_live
from palpate.sensors.nusense.nusense_sensor import NuSense
from palpate.sensors.nusense.pad_view import (
    NODE_PX,
    exposed,
    exposed_by_table,
    pad_window,
    places_by_lag,
    rest_places,
)

MM = 1e-3
SLOW = palpate.sensor("nusense")
LIVE = for_live(SLOW)
ROUND = SLOW.probe("round")
DEPTHS_MM = (0.004, 0.13, 0.72, 1.41, 1.93, 2.08)
PX_M = SLOW.spec.lens.focal_px[0] / SLOW.spec.camera_m


def _press(sensor: NuSense, depth_mm: float, **history: object) -> Contact:
    pose = Pose(6 * MM, -3 * MM, depth_mm * MM)
    return sensor.press(ROUND, pose, None, PressHistory(**history))  # type: ignore[arg-type]


def _shown_px(sensor: NuSense, depth_mm: float) -> np.ndarray:
    return PX_M * rest_places(sensor.spec, sensor.motion(_press(sensor, depth_mm)))


@pytest.mark.parametrize("depth_mm", DEPTHS_MM)
@pytest.mark.cases(1)
def test_live_pictures_are_those_of_presses_solved_anew(depth_mm: float) -> None:
    off = np.abs(_shown_px(LIVE, depth_mm) - _shown_px(SLOW, depth_mm)).max()
    assert off < 0.004
    grey = np.abs(LIVE.view(_press(LIVE, depth_mm)) - SLOW.view(_press(SLOW, depth_mm)))
    assert grey.max() < 0.3


def test_live_contacts_bear_what_the_pad_bears() -> None:
    for depth_mm in DEPTHS_MM[1:]:
        quick, anew = _press(LIVE, depth_mm), _press(SLOW, depth_mm)
        assert quick.force_n == pytest.approx(anew.force_n, rel=5e-4)
        assert quick.radius_m == pytest.approx(anew.radius_m, rel=0.01)
        cell_m2 = float((quick.x_m[1] - quick.x_m[0]) * (quick.y_m[1] - quick.y_m[0]))
        assert quick.pressure_pa.sum() * cell_m2 == pytest.approx(quick.force_n, rel=1e-9)
        assert quick.x_m.mean() == pytest.approx(6 * MM)
        assert quick.displacement_m.max() == pytest.approx(depth_mm * MM, rel=1e-3)
        assert quick.pose == anew.pose


@pytest.mark.parametrize("history", [{"path_m": ((1e-4, 0.0),)}])
def test_what_is_pulled_aside_is_solved_anew_live_too(history: dict[str, object]) -> None:
    quick, anew = _press(LIVE, 1.0, **history), _press(SLOW, 1.0, **history)
    np.testing.assert_array_equal(quick.pressure_pa, anew.pressure_pa)
    np.testing.assert_array_equal(LIVE.view(quick), SLOW.view(anew))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nusense", "flat"),
        ("nusense", "edge:20:35"),
        pytest.param("nusense-torn", "round", marks=pytest.mark.slow),
    ],
)
@pytest.mark.cases(1)
def test_other_indenters_and_torn_pads_are_solved_anew_live_too(name: str, words: str) -> None:
    slow, pose = palpate.sensor(name), Pose(2 * MM, 1 * MM, 0.5 * MM)
    live = for_live(slow)
    quick, anew = (one.press(one.probe(words), pose) for one in (live, slow))
    assert quick.force_n == anew.force_n
    np.testing.assert_array_equal(live.view(quick), slow.view(anew))


def test_live_noise_is_the_cameras_noise() -> None:
    """Mean and variance at every level, below five standard errors, and other than half as much would be."""
    spec, rng = SLOW.spec, np.random.default_rng(2)
    levels = np.linspace(20, 220, 9, dtype=np.float32)
    view = np.repeat(levels, 480 * 640 * 3 // 9)[: 480 * 640 * 3].reshape(480, 640, 3)
    means, variances = [], []
    for law in (exposed, exposed_by_table):
        parts = law(spec, np.ascontiguousarray(view), rng, 0.9).ravel()[: 9 * 100_000].astype(float)
        grey = view.ravel()[: parts.size]
        means.append([parts[grey == level].mean() for level in levels])
        variances.append([parts[grey == level].var() for level in levels])
    expected = spec.light.read_noise**2 + spec.light.shot_noise * 0.9 * levels + 1 / 12
    count = 100_000
    np.testing.assert_allclose(means[1], 0.9 * levels, atol=5 * np.sqrt(expected.max() / count) + 0.01)
    np.testing.assert_allclose(variances[1], expected, rtol=5 * np.sqrt(2 / count))
    np.testing.assert_allclose(variances[1], variances[0], rtol=7 * np.sqrt(2 / count))


def test_pixels_between_nodes_lie_on_the_cubic_spline_through_these() -> None:
    window = pad_window(SLOW.spec, (0.0, 0.0))
    lag = np.random.default_rng(3).normal(0, 1e-4, (2, *window.nodes_m.shape[:2]))
    height, width = window.light.shape
    rows, columns = (np.append(np.arange(0, size - 1, NODE_PX), size - 1) for size in (height, width))
    down = make_interp_spline(rows, lag, k=3, axis=1)(np.arange(height))
    expected = window.pixels_m + make_interp_spline(columns, down, k=3, axis=2)(np.arange(width))
    np.testing.assert_allclose(places_by_lag(window, lag), expected, atol=1e-15, rtol=0)
