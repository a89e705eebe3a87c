"""The march against Mitsuba 3, a renderer that carries Stokes vectors: a real stack of planes, ray-traced.

Each point is a small scene: a lamp, a polariser, one sheet a slice, an analyser, a camera. Mitsuba's retarder
has one retardance for all wavelengths, so each wavelength is a scene of its own. Nothing is sampled but the
wavelength, which drops out of the ratio to the same scene with the first polariser only: no noise is left.
"""

from __future__ import annotations

import numpy as np
import pytest

from palpate.mechanics import secondary_stress
from palpate.optics import StressOpticLaw, circular_amplitude, graded_slices, march, plane_amplitude, through
from palpate.optics.march import march_spectral

mi = pytest.importorskip("mitsuba", reason="Mitsuba is not installed, and only this comparison needs it")

SINGLE = 2e-6  # Mitsuba's scalar variants compute in single precision
VARIANT = "scalar_spectral_polarized"


@pytest.fixture(scope="module", autouse=True)
def polarised():
    if VARIANT not in mi.variants():
        pytest.skip(f"this Mitsuba was built without {VARIANT}")
    before = mi.variant()
    mi.set_variant(VARIANT)
    yield
    if before:
        mi.set_variant(before)


def sheet(at, bsdf, turn=0.0):
    """A plane at height `at`, turned about the ray. Light runs towards +z, the camera looks along -z.

    The plane itself is turned, not the `theta` of its material, whose sense is opposite for Mitsuba's
    polariser and its retarder when light comes from behind.
    """
    from mitsuba import ScalarTransform4f as Transform

    place = Transform().translate([0, 0, at]) @ Transform().rotate([0, 0, 1], float(np.degrees(turn)))
    return {"type": "rectangle", "to_world": place, "bsdf": bsdf}


def polariser(theta):
    return {"type": "polarizer"}, theta


def retarder(axis, phase):
    return {"type": "retarder", "delta": float(np.degrees(phase))}, axis


def rendered(sheets):
    """What the camera sees through the sheets, lamp side first."""
    from mitsuba import ScalarTransform4f as Transform

    heights = np.linspace(0, 1, len(sheets) + 2)
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": len(sheets) + 8, "rr_depth": 1000},
        "lamp": sheet(0, {"type": "diffuse"}) | {"emitter": {"type": "area", "radiance": 1.0}},
        "sensor": {
            "type": "radiancemeter",
            "to_world": Transform().look_at(origin=[0.1, 0.2, 2], target=[0.1, 0.2, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": 1},
        },
    }
    scene |= {f"sheet{i}": sheet(heights[i + 1], *one) for i, one in enumerate(sheets)}
    return np.array(mi.render(mi.load_dict(scene), seed=3))[0, 0, 1]


def transmitted(before, slices, behind):
    """Share of the polarised light that passes `behind`."""
    white = rendered([before[0]])
    return rendered([*before, *slices, *behind]) / white


def plates(u, v):
    """Sheets of the half phases u, v of a stack."""
    return [retarder(np.arctan2(b, a) / 2, 2 * np.hypot(a, b)) for a, b in zip(u, v, strict=True)]


@pytest.mark.parametrize("polariser_rad", [0.0, np.pi / 4, 0.3])
def test_one_plate_between_crossed_polarisers(polariser_rad):
    pair = [polariser(polariser_rad)], [polariser(polariser_rad + np.pi / 2)]
    u, v = np.array([[0.7]]), np.array([[0.4]])
    marched = through(march(u, v, 1.0), plane_amplitude(polariser_rad, 1)[0])
    assert transmitted(pair[0], plates(u[:, 0], v[:, 0]), pair[1]) == pytest.approx(marched[0], abs=SINGLE)


@pytest.mark.parametrize("seed", range(3))
def test_a_stack_whose_axes_turn_between_crossed_polarisers(seed):
    rng = np.random.default_rng(seed)
    u, v = 0.6 * rng.normal(size=(2, 10, 1))
    marched = through(march(u, v, 1.0), plane_amplitude(0.3, 1)[0])
    traced = transmitted([polariser(0.3)], plates(u[:, 0], v[:, 0]), [polariser(0.3 + np.pi / 2)])
    assert traced == pytest.approx(marched[0], abs=SINGLE)


@pytest.mark.parametrize("wavelength", [450e-9, 550e-9, 650e-9])
def test_a_stack_in_a_circular_polariscope_with_plates_of_another_wavelength(wavelength):
    u, v = 0.6 * np.random.default_rng(5).normal(size=(2, 10, 1))
    at = np.array([wavelength])
    marched = through(march(u, v, 1.0), circular_amplitude(at)[0])
    quarter = np.pi / 2 * 550e-9 / wavelength
    before = [polariser(0.0), retarder(np.pi / 4, quarter)]
    behind = [retarder(-np.pi / 4, quarter), polariser(np.pi / 2)]
    assert transmitted(before, plates(u[:, 0], v[:, 0]), behind) == pytest.approx(marched[0], abs=SINGLE)


@pytest.mark.parametrize("wavelength", [450e-9, 550e-9, 650e-9])
@pytest.mark.parametrize("point", [(0.6, 0.4), (-1.2, 1.0), (0.1, 0.7)])
def test_fringes_under_a_ball(point, wavelength):
    """16 slices under Hertz's contact: too few to be right, but Mitsuba and the march get the same ones."""
    x, z = (np.array([part]) for part in point)
    y, dy = graded_slices(np.sqrt(x**2 + z**2 + 1), 8)
    a, b = (part * dy for part in secondary_stress(x, y, z, 1.0, 1.0))
    difference, shear = (np.concatenate([half[::-1], half]) * 300.0 for half in (a, b))  # 0.3 MPa, a = 1 mm
    half_phase = StressOpticLaw(3e-9, dispersion_m2=1e-14).half_phase(np.array([wavelength]))
    marched = march_spectral(difference, shear, half_phase, plane_amplitude(np.pi / 4, 1))[0, 0]
    sheets = plates(*(half_phase * part[:, 0] for part in (difference, shear)))
    traced = transmitted([polariser(np.pi / 4)], sheets, [polariser(3 * np.pi / 4)])
    assert traced == pytest.approx(marched, abs=10 * SINGLE)
