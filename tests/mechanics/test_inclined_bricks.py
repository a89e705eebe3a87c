"""The inclined press in three dimensions, coarse: the head-on tables, balance, contact, and its stiffness."""

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.mechanics.axisymmetric.tilted_tip import top_modes
from palpate.mechanics.axisymmetric.tip_table import tip_table

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from finite_strain.cylinder import Cylinder
from finite_strain.frontal import Elements, eliminated
from finite_strain.inclined import Fineness, InclinedPress
from finite_strain.surface_contact import Below, below, facet_shapes, pressed as pressed_points
from finite_strain.tip import Tip
from inclined_tables import FORCES_N, at_forces, place_mm, unseen_mm

BASE = Tip(skin_mpa=0.5, gel_mpa=0.015)
COARSE = Fineness(degrees=10.0, gel=2, widest=12.0)
TILT = float(np.deg2rad(30.0))


def pressed(tilt: float, approach_mm: float, mpa: float = np.inf):
    top = Cylinder(mpa, across=8, down=4) if np.isfinite(mpa) else None
    press = InclinedPress(BASE, top, tilt, fineness=COARSE)
    return press, next(state for state in press.states() if state.approach >= approach_mm)


@pytest.fixture(scope="module")
def tilted():
    return pressed(TILT, 0.3)


def test_a_stiffness_is_the_derivative_of_the_forces_and_its_factors_undo_it(tilted) -> None:
    press, state = tilted
    body, step = press.body, 1e-6 * np.random.default_rng(1).normal(size=state.u.shape)
    _, K = body.balance(state.u)
    padded = np.append(step.ravel()[body.free], 0.0)
    step[body.held(body.coordinates)] = 0.0
    change = body.assembled(body.balance(state.u + step)[0] - body.balance(state.u - step)[0]) / 2
    product = body.assembled((K @ padded[body.dofs_of][..., None])[..., 0])
    assert_allclose(product, change, atol=1e-5 * np.abs(change).max())
    # single precision
    factors = eliminated([Elements(body.dofs_of, K, press._layer(body))], len(product))
    assert_allclose(factors.solve(product), padded[:-1], atol=5e-3 * np.abs(step).max())


@pytest.mark.parametrize("mpa", [np.inf, pytest.param(0.2419, marks=pytest.mark.slow)])
def test_head_on_the_force_is_the_tables(mpa) -> None:
    press, state = pressed(0.0, 0.6, mpa)
    upright = tip_table("base").press(1e6 * mpa)
    force = upright.force_at(np.array([1e-3 * state.approach]))[0]
    assert_allclose(press.force(state)[2], force, rtol=0.04)


def test_the_base_holds_what_the_top_pushes(tilted) -> None:
    """Forces of all cells on the held nodes are those of the contact, on both sides of the plane y = 0."""
    press, state = tilted
    body = press.body
    force, _ = body.balance(state.u)
    all_nodes = np.zeros_like(body.places)
    np.add.at(all_nodes, body.nodes_of, force.reshape(-1, 20, 3))
    base = press._held(body.coordinates)[:, 0]
    held = 2 * all_nodes[base].sum(axis=0)
    on_tip = press.force(state)
    assert_allclose(held[[0, 2]], -on_tip[[0, 2]], atol=2e-3 * np.linalg.norm(on_tip))


def test_force_is_along_the_tops_normal_which_leans_away_from_where_it_touches(tilted) -> None:
    """The first touch is at +x, so that the tip is pushed towards -x, by a wrong sign towards +x."""
    press, state = tilted
    force = press.force(state)
    assert_allclose(force[0] / force[2], -np.tan(TILT), rtol=1e-9)
    where = state.touched.places[state.touched.pressure > 1e-3]
    assert (where[:, 0] > 5.0).all()
    other, mirrored = pressed(-TILT, 0.3)
    assert_allclose(other.force(mirrored) * [-1, 1, 1], force, rtol=1e-3, atol=1e-6)
    assert not np.allclose(other.force(mirrored)[0], force[0], rtol=0.5)


@pytest.fixture(scope="module")
def bumpy() -> tuple[Below, np.ndarray, np.ndarray]:
    """Points over a top whose nodes have moved anyhow."""
    rng, top = np.random.default_rng(0), Cylinder(0.1, across=8, down=2)
    nodes = (top.body.places + 0.3 * rng.normal(size=top.body.places.shape))[top.facet_nodes]
    points = rng.uniform([-12, 1, -1], [12, 10, 1], size=(20, 3))
    return below(points, nodes), points, nodes


def test_contact_forces_are_the_gaps_derivative_and_their_stiffness_the_forces(bumpy) -> None:
    """By moving a point and the facet under it; without the normal's turning the stiffness is another."""
    found, points, nodes = bumpy
    rng = np.random.default_rng(1)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    shapes, one = facet_shapes(rng.uniform(-1, 1, (20, 2)))[0], np.ones(1)

    def moved(i: int, by: np.ndarray) -> tuple[float, np.ndarray]:
        place = points[i] + (shapes[i] @ by[:24].reshape(8, 3)) @ axes.T
        here = below(place[None], nodes[found.facet[i]][None] + by[24:].reshape(1, 8, 3))
        return here.gap[0], pressed_points(here, shapes[i : i + 1], axes, one, 0 * one)[0][0]

    inside = np.flatnonzero(
        (found.shapes[0].max(axis=1) < 0.9) & (np.abs(found.shapes[0]).min(axis=1) > 1e-3)
    )
    for i in inside[:5]:
        by = 1e-5 * rng.normal(size=48)
        (gap, force), (other, opposite) = moved(i, by), moved(i, -by)
        here = found.taken(np.array([i]))
        out, K = (part[0] for part in pressed_points(here, shapes[i : i + 1], axes, one, 0 * one))
        assert_allclose((gap - other) / 2, -out @ by, rtol=1e-5)
        change = (force - opposite) / 2
        assert_allclose(change, K @ by, atol=1e-5 * np.abs(change).max())
        _, straight = pressed_points(here, shapes[i : i + 1], axes, one, 0 * one, turning=False)
        assert np.abs(straight[0] @ by - change).max() > 0.1 * np.abs(change).max()


def test_a_cylinder_is_as_large_as_it_is_and_yields_as_fourier_modes_have_it() -> None:
    """Another code, of small strain: the rim, where the shape of a load at the middle no longer counts."""
    top = Cylinder(0.1)
    body = top.body
    assert_allclose(body._gradients[1].sum(), np.pi * top.radius**2 * top.height / 2, rtol=1e-3)
    load = np.zeros(3 * len(body.places))
    middle = np.flatnonzero(np.isclose(np.abs(body.places).max(axis=1), 0.0))
    load[3 * middle + 2] = -1.0  # N, on the half
    _, K = body.balance(np.zeros_like(body.places))
    layers = InclinedPress._layer(body)
    moved = np.zeros(load.size)
    moved[body.free] = eliminated([Elements(body.dofs_of, K, layers)], len(body.free)).solve(load[body.free])
    moved = moved.reshape(-1, 3)
    rim = np.isclose(np.hypot(*body.places[:, :2].T), top.radius) & np.isclose(body.places[:, 2], 0.0)
    theirs = top_modes(0.02, 0.04, 0.1e6, 0.48, rings=30, modes=1).top[0, -1, :, 0, 2] * -2.0 / (2 * np.pi)
    out = (moved[rim, :2] * body.places[rim, :2]).sum(axis=1) / top.radius
    assert_allclose(1e-3 * moved[rim, 2].mean(), theirs[2], rtol=0.01)
    assert_allclose(1e-3 * out.mean(), theirs[0], rtol=0.05)


def test_an_edge_seen_too_near_at_0_degrees_is_put_right_at_any_tilt() -> None:
    """By as much as is short at 0 degrees; between moduli by a straight line."""
    force = np.linspace(0.2, 5.6, 30)
    states = {}
    for mpa, short in ((np.inf, 0.1), (0.035, 0.4)):
        edge = 1e3 * tip_table("base").press(1e6 * mpa).at("radius_m", np.minimum(force, 5.5)) - short
        along = np.stack([0 * force, 0 * force, force], axis=1)
        states[0.0, mpa] = {"force_n": along, "area_mm2": np.pi * edge**2}
    unseen = unseen_mm("base", states)
    assert_allclose([unseen(place_mm("base", mpa)) for mpa in (np.inf, 0.035)], [0.1, 0.4], rtol=1e-6)
    assert 0.1 < unseen(place_mm("base", 0.2419)) < 0.25
    root = np.cbrt(force)
    press = {
        "force_n": states[0.0, np.inf]["force_n"], "area_mm2": np.pi * (4 * root - 0.3) ** 2,
        "approach_mm": root**2, "moved_mm": root[:, None] * np.ones(3),
    }  # fmt: skip
    found = at_forces(press, 0.3)
    assert_allclose(found["area_mm2"], np.pi * 16 * np.cbrt(FORCES_N) ** 2, rtol=1e-6)
    assert_allclose(found["approach_mm"][4:], np.cbrt(FORCES_N[4:]) ** 2, rtol=1e-3)
