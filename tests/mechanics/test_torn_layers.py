"""A cut in a layered pad: elements against waves in layers, and the laws of an opening."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.sparse.linalg import splu
from tests.refusals import refused

from palpate.core import InputError
from palpate.mechanics import torn_layers as cut_opening_module
from palpate.mechanics.layers.stack import ElasticLayer, Stack, climb
from palpate.mechanics.torn_layers import (
    CutOpening,
    StripMesh,
    StripStiffness,
    SurfaceCut,
    cut_opening,
    rest_gap_m,
    strip_mesh,
    wave_response,
)

NU = 0.499
LAYERS = ((0.8e-3, 0.66e6), (0.7e-3, 0.66e6), (2.2e-3, 0.2e6), (0.5e-3, 0.66e6), (0.3e-3, 1.8e6))
STACK = Stack(tuple(ElasticLayer(t, E, NU) for t, E in LAYERS))
DEPTH_M, PLANE_M, WIDE_M = 1.8e-3, 1.5e-3, 1.5e-3
CUT = SurfaceCut(0.0, 0.0, 0.0, 12e-3, DEPTH_M)


@pytest.fixture(scope="module", autouse=True)
def coarse():
    """Larger elements and fewer wavenumbers: the laws of an opening hold on any mesh."""
    solved = cut_opening_module.cut_response, cut_opening_module._compliance
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cut_opening_module, "strip_mesh", lambda stack, cut_m, _: strip_mesh(stack, cut_m, 0.4))
        patch.setattr(cut_opening_module, "SOLVED_WAVES", 8)
        for one in solved:
            one.cache_clear()
        yield
    for one in solved:
        one.cache_clear()


def _pressed_strip(k: float, finer: float = 1.0) -> tuple[StripMesh, np.ndarray]:
    """Motion of an uncut strip under a Gaussian ridge of pressure, 1 Pa high."""
    mesh = strip_mesh(STACK, DEPTH_M, finer)
    held = mesh.held
    held[mesh.unknowns(0, 0)] = True
    load, moved = np.zeros(mesh.count), np.zeros(mesh.count)
    points, weights = np.polynomial.legendre.leggauss(5)
    for i, (low, high) in enumerate(zip(mesh.sides_m[:-1], mesh.sides_m[1:], strict=True)):
        x = (low + high) / 2 + points * (high - low) / 2
        shapes = np.array([points * (points - 1) / 2, 1 - points**2, points * (points + 1) / 2])
        pressure = np.exp(-((x / WIDE_M) ** 2) / 2)
        load[mesh.row(0)[2, 2 * i : 2 * i + 3]] += shapes @ (weights * pressure) * (high - low) / 2
    free = np.flatnonzero(~held)
    moved[free] = splu(StripStiffness(mesh).at(k)[free][:, free]).solve(load[free])
    return mesh, moved


@pytest.mark.parametrize("k", [200.0])
def test_without_a_cut_elements_move_as_waves_in_layers(k: float) -> None:
    mesh, moved = _pressed_strip(k)
    period, count = 320e-3, 4096
    across = 2 * np.pi * np.fft.fftfreq(count, period / count)
    size = np.hypot(across, k)
    plane = climb(STACK.slabs, STACK.below, size)[0][2]
    per_load = plane.compliance @ plane.transmission / size[:, None, None]
    load = np.exp(-((across * WIDE_M) ** 2) / 2) * WIDE_M * math.sqrt(2 * np.pi) / period
    wave = np.exp(1j * np.outer(mesh.x_m, across)) * load
    x = (wave @ (1j * per_load[:, 0, 1] * across / size)).real
    y = (wave @ (per_load[:, 0, 1] * k / size)).real
    z = (wave @ per_load[:, 1, 1]).real
    found = moved[mesh.row(int(np.abs(mesh.z_m - PLANE_M).argmin()))]
    assert np.abs(found - [x, y, z]).max() < 5e-4 * max(np.abs(x).max(), np.abs(z).max())


def _cut_yields(finer: float) -> float:
    """What a cut sets free under a wave of load along a line 2 mm beside it."""
    mesh = strip_mesh(STACK, DEPTH_M, finer)
    stiffness, surface, _ = wave_response(StripStiffness(mesh), 300.0, DEPTH_M, PLANE_M)
    load = make_interp_spline(mesh.x_m, surface, k=3, axis=1)(2e-3).sum(axis=0)
    return float(load @ np.linalg.solve(stiffness, load))


@pytest.mark.slow
def test_finer_elements_change_what_a_cut_yields_by_a_thousandth() -> None:
    coarse, used, fine = (_cut_yields(finer) for finer in (0.5, 1.0, 2.0))
    assert used == pytest.approx(fine, rel=2e-3)
    assert coarse == pytest.approx(fine, rel=4e-3)


def _under(places_mm: Any, forces_n: Any, cut: SurfaceCut = CUT) -> CutOpening:
    return cut_opening(STACK, cut, PLANE_M, 1e-3 * np.array(places_mm), np.array(forces_n).T)


@pytest.mark.slow
def test_skin_pulled_apart_across_a_cut_opens_it_and_shear_along_it_slides_it() -> None:
    apart = _under([(0.0, 4.0), (0.0, -4.0)], [(0.0, 1.0, 0.0), (0.0, -1.0, 0.0)])
    middle = len(apart.along_m) // 2
    across, along, down = apart.jump_m[:, 0, middle]
    assert across > 50e-6
    assert abs(along) + abs(down) < 1e-3 * across
    assert apart.jump_m[0, :, middle].min() > 0
    assert np.all(np.diff(apart.jump_m[0, :, middle]) < 0)  # narrower with depth
    slid = _under([(0.0, 4.0), (0.0, -4.0)], [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)])
    across, along, down = slid.jump_m[:, 0, middle]
    assert along > 50e-6
    assert abs(across) + abs(down) < 1e-3 * along


def test_a_load_on_one_place_moves_another_as_the_other_moves_it() -> None:
    """Reciprocity of what the cut adds: work of one load on the motion by the other."""
    one, other = ([(1.0, 2.5)], [(0.3, 0.5, 1.0)]), ([(-2.0, -3.0)], [(-0.2, 1.0, 0.4)])
    both = _under(one[0] + other[0], one[1] + other[1]).work_j
    against = _under(one[0] + other[0], one[1] + [tuple(-np.array(other[1][0]))]).work_j
    alone = _under(*one).work_j + _under(*other).work_j
    assert both + against == pytest.approx(2 * alone, rel=1e-9)
    assert _under(*one).work_j > 0


def test_a_turned_and_moved_cut_is_the_cut_turned_and_moved() -> None:
    turn, place = 0.6, np.array([3.0, -2.0])
    spin = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    cut = SurfaceCut(*(1e-3 * place), turn, CUT.length_m, DEPTH_M)
    at, force, seen = np.array([1.0, 2.0]), np.array([0.2, 0.7]), np.array([2.0, -3.0])
    plain = _under([tuple(at)], [(*force, 0.5)])
    turned = _under([tuple(spin @ at + place)], [(*(spin @ force), 0.5)], cut)
    assert np.allclose(turned.jump_m, plain.jump_m, atol=1e-9 * np.abs(plain.jump_m).max())
    here = plain.at(*(1e-3 * seen[:, None]))[:, 0]
    there = turned.at(*(1e-3 * (spin @ seen + place)[:, None]))[:, 0]
    assert np.allclose(there, [*(spin @ here[:2]), here[2]], atol=1e-6 * np.abs(here).max())


def test_faces_that_meet_press_and_never_pass_each_other() -> None:
    places = [(x, y + 3.0) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)]
    forces = [(0.0, 0.0, 0.6)] * 9
    passing = _under(places, forces)
    gap = CUT._replace(gap_m=0.1e-3)
    held = _under(places, forces, gap)
    room = rest_gap_m(gap, held.along_m)
    assert (passing.jump_m[0] + room).min() < -50e-6
    assert (held.jump_m[0] + room).min() > -1e-12
    assert 0 < held.closed.sum() < held.closed.size
    assert held.work_j < passing.work_j
    wide = _under(places, forces, CUT._replace(gap_m=50e-3))
    assert np.allclose(wide.jump_m[:, :, 1:-1], passing.jump_m[:, :, 1:-1], atol=1e-9)


def test_cuts_that_are_not_in_the_pad_are_refused() -> None:
    with refused("cut-depth", InputError):
        strip_mesh(STACK, 5e-3)
    with pytest.raises(InputError, match="mm; give"):
        _under([(0.0, 0.0)], [(0.0, 0.0, 1.0)], CUT._replace(length_m=0.5e-3))
