import numpy as np
import pytest
from scipy.stats import kstest, norm

from palpate.core import RangeError
from palpate.optics import electrons, quantise, uneven_light
from palpate.optics.image_chain import normal_table, table_draws

N = 200_000


def electrons_exact(mean, read_noise_e, rng):
    """The slow reference for `electrons`: Poisson's photons and a Gaussian read-out."""
    return rng.poisson(mean) + read_noise_e * rng.standard_normal(mean.shape)


def exposed(law, mean, seed=0, read=5.0):
    return law(np.full(N, mean, dtype=np.float32), read, np.random.default_rng(seed))


@pytest.mark.parametrize("mean", [50.0, 1000.0, 15_000.0])
@pytest.mark.parametrize("law", [electrons, electrons_exact])
def test_variance_is_the_mean_plus_the_read_outs(law, mean):
    counts = exposed(law, mean)
    # five standard errors of a mean and of a variance over N pixels
    assert counts.mean(dtype=float) == pytest.approx(mean, abs=5 * np.sqrt((mean + 25) / N))
    assert counts.var(dtype=float) == pytest.approx(mean + 25, rel=5 * np.sqrt(2 / N) * 1.1)


def test_one_gaussian_stands_in_for_photons_and_read_out():
    shares = [0.01, 0.1, 0.5, 0.9, 0.99]
    quick = np.quantile(exposed(electrons, 150.0), shares)
    exact = np.quantile(exposed(electrons_exact, 150.0, seed=1), shares)
    # Poisson's skewness moves a quantile by up to 0.4 of skewness x spread, 0.4 electrons here;
    # half an 8-bit step of a 15,000 electron camera is 30
    np.testing.assert_allclose(quick, exact, atol=1.0)


def test_the_same_seed_gives_the_same_exposure_and_another_does_not():
    np.testing.assert_array_equal(exposed(electrons, 100.0), exposed(electrons, 100.0))
    assert (exposed(electrons, 100.0) != exposed(electrons, 100.0, seed=1)).any()


def test_codes_start_at_no_electrons_and_end_at_the_full_well():
    codes = quantise(np.array([-20.0, 0.0, 5000.0, 10_000.0, 12_000.0]), 10_000.0, 12)
    assert codes.tolist() == [0, 0, 2048, 4095, 4095]


def test_light_falls_from_the_centre_to_the_corners_by_the_named_loss():
    light = uneven_light(101, 201, 0.3)
    assert light.max() == light[50, 100] == 1.0
    assert light[0, 0] == pytest.approx(0.7, abs=0.01)  # the corner pixel's centre is half a pixel inside
    np.testing.assert_array_equal(light, light[::-1, ::-1])


def test_a_loss_of_more_than_all_light_is_refused():
    with pytest.raises(RangeError, match="corner loss"):
        uneven_light(10, 10, 1.2)


def table_noise(count, seed=0):
    return normal_table()[table_draws(np.random.default_rng(seed), count)]


def test_noise_from_the_table_is_normal():
    noise = table_noise(N).astype(float)
    assert kstest(noise, "norm").pvalue > 0.01
    moments = [np.mean(noise**k) for k in (1, 2, 3, 4)]
    # five standard errors: a normal value's powers vary by 1, 2, 15 and 96
    for moment, expected, variance in zip(moments, (0, 1, 0, 3), (1, 2, 15, 96), strict=True):
        assert moment == pytest.approx(expected, abs=5 * np.sqrt(variance / N))
    assert kstest(1.02 * noise, "norm").pvalue < 0.01  # so that the test can fail
    assert kstest(np.rint(8 * noise) / 8, "norm").pvalue < 0.01


def test_the_tables_values_are_those_of_equal_shares_of_a_normal_distribution():
    table = normal_table().astype(float)
    steps = np.arange(len(table)) / len(table)
    reached = norm.cdf(table)
    assert np.abs(reached - steps).max() < 1 / 99_000
    assert np.abs(reached - steps - 1 / len(table)).max() < 1 / 99_000
    assert table.mean() == pytest.approx(0.0, abs=1e-9)
    assert table.var() == pytest.approx(1.0, abs=1e-6)
    assert 2 * norm.sf(table[-1]) == pytest.approx(1 / 65_000, rel=0.01)
    assert table[-1] == pytest.approx(4.325, abs=0.001)


def test_draws_from_the_table_do_not_depend_on_each_other():
    rng = np.random.default_rng(5)
    one, other = (normal_table()[table_draws(rng, N)].astype(float) for _ in range(2))
    for apart in (1, 2, 3, 4, 5, 8, 640):
        for values in (one, one**2 - 1, np.abs(one) - np.sqrt(2 / np.pi)):
            together = np.mean(values[apart:] * values[:-apart]) / np.var(values)
            assert abs(together) < 5 / np.sqrt(N - apart)
    assert abs(np.mean(one * other)) < 5 / np.sqrt(N)
    assert (table_noise(N) != table_noise(N, seed=1)).any()
    np.testing.assert_array_equal(table_noise(N), table_noise(N))
    assert len(table_noise(7)) == 7
