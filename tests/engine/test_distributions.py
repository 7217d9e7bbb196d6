"""The engine's own distributions are those of scipy.stats, which takes too long to load."""

import math

import numpy as np
import pytest
from scipy import stats

from engine import distributions as own

VALUES = np.array([-np.inf, -1.0, 0.0, 1e-300, 0.3, 2.0, 50.0, 1e4, np.inf, np.nan])
CHANCES = np.array([0.0, 1e-300, 1e-12, 0.05, 0.5, 0.975, 1.0, np.nan])


@pytest.mark.parametrize("degrees", [1, 2, 7, 300])
def test_chi2(degrees):
    known = stats.chi2(degrees)
    np.testing.assert_allclose(own.chi2_sf(VALUES, degrees), known.sf(VALUES), rtol=1e-12)
    np.testing.assert_array_equal(own.chi2_isf(CHANCES, degrees), known.isf(CHANCES))
    np.testing.assert_array_equal(own.chi2_quantile(CHANCES, degrees), known.ppf(CHANCES))


def test_the_tail_of_one_degree_of_freedom_is_a_normal_ones():
    assert own.chi2_sf(2.0, 1) == pytest.approx(math.erfc(1.0), rel=1e-15, abs=0.0)
    assert own.chi2_sf(VALUES[:, None], np.array([1, 2])).shape == (len(VALUES), 2)


def test_normal():
    np.testing.assert_array_equal(own.normal_sf(VALUES), stats.norm.sf(VALUES))
    np.testing.assert_array_equal(own.normal_isf(CHANCES), stats.norm.isf(CHANCES))
    np.testing.assert_array_equal(own.normal_quantile(CHANCES), stats.norm.ppf(CHANCES))


@pytest.mark.parametrize("degrees", [1, 5, 200])
def test_student(degrees):
    found = [own.student_sf(value, degrees) for value in VALUES]
    np.testing.assert_array_equal(found, stats.t.sf(VALUES, degrees))
    assert own.student_quantile(0.975, degrees) == pytest.approx(stats.t.ppf(0.975, degrees))


@pytest.mark.parametrize("n", [20, 57, 400])
def test_kurtosis(n):
    rng = np.random.default_rng(n)
    for values in (rng.normal(3.0, 2.0, n), rng.standard_t(3, n), rng.random(n), rng.choice(2, n)):
        assert own.kurtosis_z(values) == pytest.approx(stats.kurtosistest(values).statistic)
