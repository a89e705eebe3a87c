"""Laws of the strain of a skin's pattern."""

import numpy as np
import pytest
from tests.refusals import refused

import palpate
from palpate.core import InputError, Pose, RangeError
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.surface_strain import on_plane, strain_fields

PITCH = 2.4e-3
H = np.array([[0.03, 0.011], [-0.004, -0.02]])


def rest(columns=20, rows=15, pitch=PITCH, turn=0.1, sigma=0.0, unit="m"):
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    cells = np.column_stack([column.ravel(), row.ravel()])
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return ControlPoints(cells, pitch * (cells - cells.mean(axis=0)) @ R.T, np.full(len(cells), sigma), unit)


def moved(points, gradient=H, shift=(1e-3, -2e-3), sigma=0.0):
    places = points.places @ (np.eye(2) + gradient).T + np.array(shift)
    return ControlPoints(points.cells, places, np.full(len(points), sigma), points.unit)


def without(points, rows):
    return ControlPoints(
        *(np.delete(part, rows, axis=0) for part in (points.cells, points.places, points.sigma)), points.unit
    )


@pytest.mark.parametrize("degree", [1, 3])
def test_an_imposed_affine_strain_comes_back(degree):
    gone = np.random.default_rng(3).permutation(300)[:30]
    fields = strain_fields(rest(), without(moved(rest()), gone), degree, (40, 30))
    seen = fields.basis.supported
    np.testing.assert_allclose(
        fields.gradient[:, :, seen], np.broadcast_to(H[..., None], (2, 2, seen.sum())), atol=1e-5
    )
    assert np.isnan(fields.gradient[:, :, ~seen]).all()
    np.testing.assert_allclose(fields.shear[seen], 0.007, atol=1e-5)
    np.testing.assert_allclose(fields.area_strain[seen], 0.01, atol=1e-5)
    np.testing.assert_allclose(fields.rotation_rad[seen], -0.0075, atol=1e-5)
    values, vectors = np.linalg.eigh((H + H.T) / 2)
    principal = fields.principal()
    np.testing.assert_allclose(principal.greatest[seen], values[1], atol=1e-5)
    np.testing.assert_allclose(principal.least[seen], values[0], atol=1e-5)
    np.testing.assert_allclose(
        principal.direction_rad[seen], np.arctan(vectors[1, 1] / vectors[0, 1]), atol=1e-3
    )
    np.testing.assert_allclose(fields.greatest_shear[seen], values[1] - values[0], atol=1e-5)


def test_affine_strain_through_the_fisheye_comes_back_to_one_in_a_thousand():
    """Corners with noise of 0.05 px, of the lens's places back to the plane; the mean over the field."""
    rng, spec = np.random.default_rng(5), palpate.sensor("nusense").spec
    plain = rest(turn=0.0)
    seen = []
    for points in (plain, moved(plain, shift=(2e-4, 1e-4))):
        x, y = points.places.T
        px = spec.lens.project(np.stack([x, -y, np.full(len(x), spec.camera_m)], axis=-1))
        noisy = px + 0.05 * rng.normal(size=px.shape)
        seen.append(
            on_plane(ControlPoints(points.cells, noisy, np.full(len(x), 0.05)), spec.lens, spec.camera_m)
        )
    fields = strain_fields(*seen, samples=(39, 29))
    np.testing.assert_allclose(fields.gradient.mean(axis=(2, 3)), H, atol=1e-3)
    raw = strain_fields(
        *(
            ControlPoints(
                plain.cells,
                spec.lens.project(np.column_stack([p.places * [1, -1], np.full(300, spec.camera_m)])),
                np.zeros(300),
            )
            for p in seen
        )
    )
    assert np.abs(raw.gradient[0, 0] - H[0, 0]).max() > 1e-3  # the control: pixels of the fisheye as they are


def test_a_reference_that_folds_is_refused():
    folded = rest()
    places = folded.places.copy()
    places[50], places[55] = folded.places[55], folded.places[50]
    with pytest.raises(RangeError, match="fold"):
        strain_fields(ControlPoints(folded.cells, places, folded.sigma, "m"), rest())


def test_a_plane_needs_pixels_and_a_distance():
    lens = palpate.sensor("nusense").spec.lens
    with refused("unit-differs", InputError):
        on_plane(rest(), lens, 0.05)
    with pytest.raises(InputError, match="one unit"):
        strain_fields(rest(), rest(unit="px"))
    with refused("not-positive", RangeError):
        on_plane(rest(pitch=10, unit="px"), lens, 0.0)


def test_the_layered_solutions_ring_comes_back():
    """Greatest shear over the ring of a 6 N press, its mean beside the truth's; degree 1 is the control."""
    sensor = palpate.sensor("nusense")
    spec, rng = sensor.spec, np.random.default_rng(6)
    contacts = [sensor.press(sensor.probe("round"), Pose(3e-3, 2e-3, depth)) for depth in (0.0, 1.46e-3)]
    marks = []
    for contact in contacts:
        truth = sensor.tile_corners(contact)
        px = truth.places_px + 0.05 * rng.normal(size=truth.places_px.shape)
        marks.append(
            on_plane(ControlPoints(truth.cells, px, np.full(len(px), 0.05)), spec.lens, spec.camera_m)
        )
    motion = sensor.motion(contacts[1])

    def seen(x, y):
        u = motion.at(x.ravel(), y.ravel()).reshape(3, *x.shape)
        return np.stack([x + u[0], y + u[1]]) * spec.camera_m / (spec.camera_m - u[2])

    off = []
    for degree in (3, 1):
        fields = strain_fields(*marks, degree)
        (x, y), h = fields.at, 2e-5
        by_x, by_y = (seen(x + h, y) - seen(x - h, y)) / (2 * h), (seen(x, y + h) - seen(x, y - h)) / (2 * h)
        truth = np.hypot(by_x[0] - by_y[1], by_x[1] + by_y[0])
        ring = truth > truth.max() / 2
        off.append(fields.greatest_shear[ring].mean() / truth[ring].mean() - 1)
    assert abs(off[0]) < 0.05
    assert -0.25 < off[1] < -0.1
