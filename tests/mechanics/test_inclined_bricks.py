"""The inclined press in three dimensions, coarse: the head-on tables, balance, and its stiffness."""

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.mechanics.axisymmetric.tilted_tip import top_modes
from palpate.mechanics.axisymmetric.tip_table import tip_table

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from finite_strain.bricks import AT, serendipity
from finite_strain.inclined import Fineness, InclinedPress
from finite_strain.linear_top import LinearTop
from finite_strain.tip import Tip

BASE = Tip(skin_mpa=0.5, gel_mpa=0.015)
COARSE = Fineness(degrees=10.0, gel=2, widest=12.0)
TILT = float(np.deg2rad(30.0))


def pressed(tilt: float, approach_mm: float, mpa: float = np.inf):
    top = LinearTop(mpa, rings=6, modes=4) if np.isfinite(mpa) else None
    press = InclinedPress(BASE, top, tilt, fineness=COARSE)
    return press, next(state for state in press.states() if state.approach >= approach_mm)


@pytest.fixture(scope="module")
def tilted():
    return pressed(TILT, 0.6)


def test_shape_functions_are_one_at_their_node_and_sum_to_one() -> None:
    N, D = serendipity(AT.astype(float))
    assert_allclose(N, np.eye(20), atol=1e-14)
    at = np.array([[0.3, -0.2, 0.7]])
    N, D = serendipity(at)
    assert_allclose(N.sum(), 1.0)
    step = 1e-6 * np.eye(3)
    for i in range(3):
        ahead, behind = (serendipity(at + sign * step[i])[0] for sign in (1, -1))
        assert_allclose(D[0, :, i], (ahead - behind)[0] / 2e-6, atol=1e-8)


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
    assert_allclose(
        body.factored(K).solve(product[:, None])[:, 0], padded[:-1], atol=5e-3 * np.abs(step).max()
    )


@pytest.mark.parametrize(("mpa", "within"), [(np.inf, 0.04), (0.2419, 0.04)])
def test_head_on_the_force_is_the_tables(mpa, within) -> None:
    press, state = pressed(0.0, 1.0, mpa)
    upright = tip_table("base").press(1e6 * mpa)
    force = upright.force_at(np.array([1e-3 * state.approach]))[0]
    assert_allclose(press.force(state)[2], force, rtol=within)


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
    other, mirrored = pressed(-TILT, 0.6)
    assert_allclose(other.force(mirrored) * [-1, 1, 1], force, rtol=1e-3, atol=1e-6)
    assert not np.allclose(other.force(mirrored)[0], force[0], rtol=0.5)


def test_a_small_press_along_the_normal_is_as_hard_at_the_side_as_at_the_apex(tilted) -> None:
    press, state = tilted
    along = 1e-3 * state.approach * np.cos(TILT)
    upright = tip_table("base").press(np.inf).force_at(np.array([along]))[0]
    assert_allclose(np.linalg.norm(press.force(state)), upright, rtol=0.05)


def test_a_linear_top_yields_as_the_linear_model_has_it() -> None:
    """Under an even load of mode 0 on a ring of nodes, and its energy is that of half the cylinder."""
    top = LinearTop(0.1, modes=2)
    other = top_modes(0.02, 0.04, 0.1e6, 0.48, rings=30, modes=1)
    nodes = 2 * len(top.knots) - 1
    load = np.zeros(top.size)
    load[0] = 1.0  # N on the axis, on the half
    ours = np.linalg.solve(top.stiffness, load)[nodes - 1]
    assert ours > 0
    # far from the load its shape does not count: at the rim, by 2 N on the whole
    theirs = 2.0 * other.top[0, -1, 2, 0, 2] / (2 * np.pi)
    assert_allclose(1e-3 * ours, theirs, rtol=0.03)
