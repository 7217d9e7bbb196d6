"""How uncertain a fit of a free run is said to be, where its errors last; what its derivatives do not tell."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from engine.simulation.covariance import run_covariance


@pytest.mark.parametrize(("noise", "tied"), [(5e-4, True), (1e-6, False)])
def test_a_weak_direction_counts_where_it_exceeds_its_noise(noise, tied):
    rng = np.random.default_rng(0)
    a = rng.normal(size=(200, 1))
    apart = 0.0 if tied else 5e-4  # columns that are one but for noise, or that differ by as much
    exact = np.hstack([a, a + apart * rng.normal(size=a.shape)])
    J, again = (exact + noise * rng.normal(size=exact.shape) for _ in range(2))
    e, rows, record = rng.normal(size=200), np.arange(200), np.zeros(200, dtype=np.intp)
    found = run_covariance(e, J, record, rows, record, lambda: again)
    assert found.tied.tolist() == [tied, tied]
    assert not run_covariance(e, J, record, rows, record).tied.any()


def lagged(x, length):
    """What a plant of first order makes of x (n,), which remembers so many rows."""
    share = np.exp(-1.0 / length)
    return lfilter([0.0, 1.0 - share], [1.0, -share], x)


def derivatives(rng, n, length=20.0, hold=15):
    """By the gain, the time constant and the first state of a plant whose input is held for some rows."""
    u = np.repeat(rng.normal(size=n // hold + 2), hold)[:n]
    x = lagged(u, length)
    return np.column_stack((x, lagged(x - u, length), np.exp(-np.arange(n) / length)))


def noise(rng, n, length=20.0, white=0.3):
    """Errors that process noise makes in such a plant, and noise of readings."""
    return length * lagged(rng.normal(size=n), length) * np.sqrt(2.0 / length) + white * rng.normal(
        size=n
    )


def of_one(rng, n=300, length=20.0, white=0.3):
    J, e = derivatives(rng, n, length, int(0.75 * length)), noise(rng, n, length, white)
    return e, J, np.zeros(n, dtype=np.intp), np.arange(n), np.zeros(n, dtype=np.intp)


def fast(rng):
    """Sampled far faster than anything moves, with a noise of readings as large as the error."""
    return of_one(rng, 3000, 150.0, 1.0)


def white(rng):
    e, *others = of_one(rng)
    return (rng.normal(size=len(e)), *others)


def walk(rng):
    """Errors that are never forgotten, of a plant that adds up."""
    e, J, *others = of_one(rng)
    return (np.cumsum(noise(rng, len(e), 1e-3)), np.cumsum(J[:, :2], axis=0), *others)


def with_gaps(rng):
    e, J, record, row, channel = of_one(rng, 400)
    seen = rng.random(len(e)) < 0.7
    return e[seen], J[seen], record[seen], row[seen], channel[seen]


def two_channels(rng):
    """Two sensors of what one noise has moved."""
    e, J, record, row, channel = of_one(rng)
    second = np.column_stack([lagged(column, 5.0) for column in J.T])
    both = np.concatenate((e, lagged(e, 5.0) + 0.3 * rng.normal(size=len(e))))
    return (
        both,
        np.concatenate((J, second)),
        *(np.tile(one, 2) for one in (record, row)),
        np.concatenate((channel, channel + 1)),
    )


def uneven(rng):
    """Shocks that are as large as the input."""
    e, J, *others = of_one(rng)
    return (lagged(rng.normal(size=len(e)) * np.abs(J[:, 0]), 20.0), J, *others)


@pytest.mark.long
@pytest.mark.parametrize(
    "case", [of_one, fast, white, walk, with_gaps, two_channels, uneven], ids=lambda f: f.__name__
)
def test_two_standard_errors_hold_the_truth(case):
    held, ratio = [], []
    for k in range(100):
        e, J, *where = case(np.random.default_rng([k, 5]))
        p = np.linalg.lstsq(J, e)[0]
        found = run_covariance(e - J @ p, J, *where)
        errors = np.sqrt(np.diag(found.covariance))[:2]
        held.append(np.abs(p[:2]) <= 1.96 * errors)
        ratio.append(p[:2] / errors)
    assert (np.mean(held, axis=0) >= (0.84 if case is two_channels else 0.89)).all()
    assert (np.std(ratio, axis=0) > 0.6).all()  # nor are they wide for nothing


def test_units_of_readings_and_parameters_do_not_matter():
    e, J, *where = of_one(np.random.default_rng(1))
    e = e - J @ np.linalg.lstsq(J, e)[0]
    units = np.array([1e6, 1e-5, 1.0])
    one, other = run_covariance(e, J, *where), run_covariance(1e-8 * e, 1e-8 * J / units, *where)
    np.testing.assert_allclose(
        np.sqrt(np.diag(other.covariance)), units * np.sqrt(np.diag(one.covariance)), 1e-5
    )
    np.testing.assert_allclose(other.degrees, one.degrees, 1e-4)


def test_a_record_as_short_as_its_errors_last_has_few_degrees_of_freedom():
    few, many = (
        [run_covariance(*of_one(np.random.default_rng(k), n)).degrees[0] for k in range(10)]
        for n in (60, 2000)
    )
    assert np.median(few) < 3.0 < 20.0 < min(many)


def test_without_residuals_nothing_is_uncertain():
    e, J, *where = of_one(np.random.default_rng(1))
    assert not run_covariance(0.0 * e, J, *where).covariance.any()
