"""Where EM leaves from: a distant start in another basin, and who decides."""

from __future__ import annotations

import numpy as np
import pytest

from engine import Gaussian, MixedModel, Parameter, Series, get_model, rbpf, rbps_em, simulate
from engine.errors import OptionError
from engine.estimation import start as module
from engine.estimation.e_steps import rbps_step
from engine.estimation.quasi_ml import quasi_ml
from engine.estimation.start import WarmStart
from engine.estimation.wandering import clearly_likelier

# a start from which plain EM ends at theta_4 = 0, about 40 below in log-likelihood
LOST = {"theta_1": 1.86, "theta_2": 0.47, "theta_3": 0.57, "theta_4": 0.17, "theta_5": 0.22}


@pytest.fixture(scope="module")
def series():
    return simulate(get_model("mixed-4"), None, 120, np.random.default_rng(16)).series


@pytest.mark.slow
def test_a_start_in_another_basin_is_left_and_the_trace_begins_with_it(series):
    model = get_model("mixed-4")
    options = {"n_particles": 50, "n_iterations": 5}
    warm = rbps_em(model, series, LOST, **options)
    cold = rbps_em(model, series, LOST, warm_start=False, **options)
    truth = rbps_em(model, series, None, warm_start=False, **options)
    assert np.allclose(warm.trace[0], list(LOST.values()))
    assert warm.log_likelihood[0] == cold.log_likelihood[0]
    assert warm.log_likelihood[-1] > truth.log_likelihood[-1] - 5.0
    assert cold.log_likelihood[-1] < truth.log_likelihood[-1] - 20.0


@pytest.mark.slow
def test_resuming_a_warm_started_run_gives_the_same_bits(series):
    model = get_model("mixed-4")
    whole = rbps_em(model, series, LOST, n_particles=8, n_iterations=3)
    first = rbps_em(model, series, LOST, n_particles=8, n_iterations=1)
    again = rbps_em(model, series, LOST, n_particles=8, n_iterations=3, resume=first.checkpoint)
    assert np.array_equal(whole.trace, again.trace)


@pytest.mark.long
def test_uphill_climbs_to_the_maximum_above_the_start_alone(series, monkeypatch):
    """From near the maximum both searches find it; uphill evaluates the filter a fraction as often."""
    model = get_model("mixed-4")
    theta, indices = model.theta(), model.free_indices(None)
    climbs = []
    monkeypatch.setattr(module, "quasi_ml", lambda *a, **o: climbs.append(1) or quasi_ml(*a, **o))
    around = WarmStart(model, [series], indices).maxima(theta)[0]
    searched = len(climbs)
    uphill = WarmStart(model, [series], indices, around=False).maxima(theta)
    assert len(climbs) - searched == 1 < searched
    d = (np.asarray(uphill[0]) - np.asarray(around))[indices]
    assert len(uphill) == 1
    assert d @ quasi_ml(model, series, around).information @ d < 0.1


def test_uphill_from_where_there_is_no_likelihood_searches_around():
    def dynamics(a, u, t, dt, theta):
        return [0.0], [[0.9 * np.exp(-np.square(theta.k))]], [[np.exp(theta.k)]]

    model = MixedModel(
        name="overflows",
        nonlinear={},
        linear={"z": "1"},
        outputs={"y": "1"},
        parameters=[Parameter("k", 800.0, "1", (-1000.0, 1000.0))],
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[0.1]]),
        initial=lambda theta: (Gaussian([], np.zeros((0, 0))), [0.0], [[1.0]]),
    )
    series = Series(np.random.default_rng(0).standard_normal(60))
    with np.errstate(all="ignore"):
        found = WarmStart(model, [series], np.array([0]), around=False)(model.theta())
    assert -2.0 < found[0]["k"] < 2.0


def test_another_way_to_start_is_refused(series):
    with pytest.raises(OptionError, match="'uphill'") as error:
        rbps_em(get_model("mixed-4"), series, warm_start="downhill")
    assert error.value.field == "warm_start"


def test_only_free_parameters_move(series):
    model = get_model("mixed-4")
    start = model.theta({"theta_2": 0.1, "theta_3": 0.31})
    found = WarmStart(model, [series], model.free_indices(["theta_2"]))(start)
    assert found[0]["theta_3"] == 0.31
    assert 0.5 < found[0]["theta_2"] < 1.6


@pytest.mark.slow
def test_searches_that_come_to_a_known_maximum_end_there(series, monkeypatch):
    """The maxima are those of searches that all go to their end, in fewer iterations."""
    model = get_model("mixed-4")
    theta, indices = model.theta(), model.free_indices(None)
    counts = []

    def counted(*args, **options):
        found = quasi_ml(*args, **options)
        counts[-1] += found.iterations
        return found

    monkeypatch.setattr(module, "quasi_ml", counted)
    maxima = []
    for once in (True, False):
        counts.append(0)
        maxima.append(WarmStart(model, [series], indices, once=once).maxima(theta))
    assert counts[0] < counts[1]
    assert len(maxima[0]) == len(maxima[1])
    fit = quasi_ml(model, series, maxima[1][0])
    for one, other in zip(*maxima, strict=True):
        d = (np.asarray(one) - np.asarray(other))[indices]
        assert d @ fit.information @ d < 0.01


def test_a_search_that_is_left_is_given_up(series):
    model = get_model("mixed-4")
    seen = []
    found = quasi_ml(
        model, series, leave=lambda theta, value, information: seen.append(value) or len(seen) == 2
    )
    assert found.given_up
    assert not found.converged
    assert found.iterations == 2
    assert found.log_likelihood == seen[-1]


@pytest.mark.slow
def test_the_higher_of_two_maxima_is_told_by_more_than_one_filter():
    """They are 4 nats apart, and the log-likelihood of one filter of 50 particles scatters by 2."""
    model = get_model("mixed-4")
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(1, 0)))
    series = simulate(model, None, 200, rng).series
    high = model.theta([0.77, 1.29, 0.26, 0.945, 0.33])
    low = model.theta([0.51, 1.56, -0.20, 0.954, -0.335])
    single = [
        rbpf(model, high, series, 50, k).log_likelihood
        < rbpf(model, low, series, 50, k + 100).log_likelihood
        for k in range(20)
    ]
    assert any(single)
    particles = rbps_step(model, [series], 50, 50)
    for seed in range(3):
        assert clearly_likelier(low, high, particles, seed)
        assert not clearly_likelier(high, low, particles, seed)
    far = model.theta([1.178, 1.639, 0.373, 0.0506, 1.028])
    maxima = WarmStart(model, [series], model.free_indices(None))(far)
    assert any(theta["theta_3"] > 0.0 for theta in maxima)  # the other one may be left on the way
    for seed in range(2):
        found = rbps_em(model, series, far, n_iterations=1, seed=seed)
        assert found.trace[1][2] > 0.0


@pytest.mark.slow
def test_between_maxima_that_the_data_do_not_tell_apart_the_start_decides():
    """Of eq. (34)'s likelihood, near -0.1 and 0.1; here they are 0.1 nats apart."""
    model = get_model("linear-2")
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(5, 0)))
    series = simulate(model, None, 200, rng).series
    values = [quasi_ml(model, series, [side]).log_likelihood for side in (-0.1, 0.1)]
    assert abs(np.diff(values)[0]) < 0.3
    for start in (0.3, -0.3):
        for seed in range(3):
            found = rbps_em(model, series, [start], n_iterations=1, seed=seed)
            assert found.trace[1][0] == pytest.approx(np.sign(start) * 0.1, abs=0.03)


def test_a_start_without_a_particle_left_is_left_for_one_that_has_some():
    class Lost:
        n_particles = 50

        def log_likelihood(self, theta, times, rng):
            return -np.inf if theta == "lost" else -300.0 + rng.standard_normal()

    assert clearly_likelier("lost", "fine", Lost(), 0)
    assert not clearly_likelier("fine", "lost", Lost(), 0)
    assert not clearly_likelier("lost", "lost", Lost(), 0)


def test_maxima_come_by_height_for_who_cannot_ask_particles(series, monkeypatch):
    """The one above the start comes first for EM, which asks particles about the others."""
    model = get_model("mixed-4")
    theta, indices = model.theta(), model.free_indices(None)
    highest, above = model.theta(LOST), model.theta()
    for by_height, first in ((False, above), (True, highest)):
        ahead = WarmStart(model, [series], indices, by_height=by_height)
        monkeypatch.setattr(ahead, "maxima", lambda _: [highest, above])
        ahead.above = above
        assert ahead(theta)[0] is first
