"""The tip on an inclined top, of coarse linear bodies and by table: symmetry, places, force and area."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core.errors import RangeError
from palpate.mechanics.axisymmetric.tilted_tip import tip_modes, top_modes
from palpate.mechanics.axisymmetric.tip_table import tip_table
from palpate.sensors.tactip import TacTipSpec, inclined_press as module, tactip, tactip_sensor
from palpate.sensors.tactip.inclined_press import Inclined, SideOn, inclined
from palpate.sensors.tactip.tactip_press import LeaningSkin, lattice

TILT = float(np.deg2rad(30))


@pytest.fixture(scope="module")
def tilted() -> dict[str, Inclined | SideOn]:
    """A rigid and a soft specimen at 30 degrees; meshes and states fewer than shipped, and nothing cached."""
    table = tip_table("base")
    coarse = tip_modes(
        table.radius_m, table.skin_m, table.skin_pa, table.gel_pa, table.poisson_ratio,
        rings=20, azimuths=14, modes=16,
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "tip_of", lambda name: (table, coarse))
        patch.setattr(module, "_unit_top", lambda r, h, nu: top_modes(r, h, 1.0, nu, rings=16, modes=16))
        patch.setattr(module, "STATES", 7)
        linear = {
            name: module._inclined.__wrapped__("base", 0.5, pa, TILT)
            for name, pa in (("rigid", np.inf), ("soft", 5e4))
        }
    tables = {"table": np.inf, "soft table": 5e4}
    return linear | {name: inclined(TacTipSpec(friction=0.0), pa, TILT) for name, pa in tables.items()}


BOTH = pytest.mark.parametrize("name", ["rigid", "soft", "table", "soft table"])


def depth(specimen: Inclined | SideOn, force_n: float) -> float:
    deep = np.linspace(0, specimen.deepest_m, 2000)
    return float(np.interp(force_n, specimen.force_n(deep), deep))


def places(specimen: Inclined | SideOn, force_n: float, lean=(0.0, 0.0)):
    spec = tactip()
    skin = specimen.skin(depth(specimen, force_n), lean)
    return skin.at(*lattice(spec.pins, specimen.inner_radius_m))


@BOTH
def test_a_field_is_its_own_mirror_across_the_slope(tilted, name) -> None:
    """The top leans along x; pins at y and -y are each other's mirror."""
    spec = tactip()
    polar, azimuth = lattice(spec.pins, tilted[name].inner_radius_m)
    skin = tilted[name].skin(depth(tilted[name], 4.0), (0.0, 0.0))
    (at, normals), (other, others) = skin.at(polar, azimuth), skin.at(polar, -azimuth)
    assert_allclose(other, at * [1, -1, 1], atol=1e-8)
    assert_allclose(others, normals * [1, -1, 1], atol=1e-6)


@BOTH
def test_normals_are_those_of_the_places_around(tilted, name) -> None:
    """Across two steps on the skin, from places alone."""
    polar, azimuth = lattice(tactip().pins, tilted[name].inner_radius_m)
    polar, azimuth = polar[1:], azimuth[1:]  # on the axis azimuth is none
    skin = tilted[name].skin(depth(tilted[name], 4.0), (0.0, 0.0))
    out = skin.at(polar + 1e-4, azimuth)[0] - skin.at(polar - 1e-4, azimuth)[0]
    around = skin.at(polar, azimuth + 1e-4)[0] - skin.at(polar, azimuth - 1e-4)[0]
    normal = np.cross(out, around)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    assert_allclose(np.abs((normal * skin.at(polar, azimuth)[1]).sum(axis=1)), 1.0, atol=1e-5)


@pytest.mark.parametrize(("name", "times"), [("rigid", 3), ("table", 1.8)])
def test_the_tip_is_pushed_in_on_the_side_that_touches(tilted, name, times) -> None:
    """Without friction, as in the table, all of the tip sways."""
    (rest, _), (now, _) = (places(tilted[name], force) for force in (0.0, 4.0))
    moved = np.linalg.norm(now - rest, axis=1)
    x = rest[:, 0]
    sides = moved[x > 5e-3].mean(), moved[x < -5e-3].mean()
    assert sides[0] > times * sides[1]


@pytest.mark.parametrize("name", ["rigid", "soft"])
def test_force_rises_with_approach_and_area_with_force(tilted, name) -> None:
    specimen = tilted[name]
    deep = np.linspace(0, specimen.deepest_m, 200)
    force = specimen.force_n(deep)
    assert force[0] == 0
    assert (np.diff(force) > 0).all()
    assert force[-1] >= 5.5
    assert_allclose(specimen.force_n(specimen.approach_m), specimen.lift_n, rtol=1e-9, atol=1e-12)
    area = specimen.area_m2(np.linspace(0, 5.5, 100))
    assert area[0] == 0
    assert (np.diff(area) > 0).all()
    # whole cells of a coarse mesh are counted: a tenth at large contacts
    large = specimen.lift_n > 2
    assert_allclose(specimen.area_m2(specimen.lift_n[large]), specimen.touched_m2[large], rtol=0.1)


def test_a_lean_turns_the_whole_field_about_the_domes_centre(tilted) -> None:
    """A lean of 0.03 rad along x moves every place by as much as that turn of the sphere does."""
    specimen = tilted["soft"]
    turned = specimen.skin(0.0, (0.03, 0.0))
    assert isinstance(turned, LeaningSkin)
    at, _ = turned.at(*lattice(tactip().pins, specimen.inner_radius_m))
    still, _ = places(specimen, 0.0)
    assert_allclose(at, still, atol=1e-9)  # the untouched dome looks alike from everywhere
    (upright, _), (leant, _) = (places(specimen, 4.0, lean) for lean in ((0.0, 0.0), (0.03, 0.0)))
    off = np.linalg.norm(leant - upright, axis=1)
    assert 1e-5 < off.max() < 0.03 * 0.02


@pytest.mark.parametrize(
    ("pa", "tilt"), [(0.0, 0.5), (-1.0, 0.5), (1e5, -0.1), (1e5, 1.0), (np.nan, 0.5), (1e5, np.nan)]
)
def test_what_is_not_modelled_is_refused(pa, tilt) -> None:
    with refused("tilt-range", RangeError):
        inclined(tactip(), pa, tilt)


def test_where_there_is_a_table_a_press_is_of_the_head_on_law() -> None:
    smooth = tactip_sensor.TacTip(TacTipSpec(friction=0.0))
    for words in ("rigid@30", "rigid@45", "specimen=1.1@30", "specimen=7.6@45"):
        upright, leaning = smooth.on(words[:-3]), smooth.on(words)
        assert isinstance(leaning, SideOn)
        assert leaning.law == upright.law


@pytest.mark.parametrize(
    ("spec", "pa", "degrees"),
    [
        (TacTipSpec(friction=0.1), np.inf, 30.0),
        (TacTipSpec("even", friction=0.0), np.inf, 30.0),
        (TacTipSpec(friction=0.0), np.inf, 29.0),
        (TacTipSpec(friction=0.0), 3e4, 30.0),
        (TacTipSpec(friction=0.0), 5e4, 45.0),
    ],
)
def test_what_no_table_holds_is_asked_of_linear_bodies(spec, pa, degrees, tilted, monkeypatch) -> None:
    asked = []
    monkeypatch.setattr(module, "linear_inclined", lambda *args: asked.append(args) or tilted["soft"])
    inclined(spec, pa, float(np.deg2rad(degrees)))
    assert asked == [(spec, pa, float(np.deg2rad(degrees)))]
