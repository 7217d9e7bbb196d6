"""RBPS-EM as a whole: against exact EM, and what callers rely on, by either method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine import (
    MixedModel,
    OptionError,
    Outcome,
    Parameter,
    Series,
    SeriesError,
    continuous,
    get_model,
    kalman_smoother,
    ps_em,
    rb_ffbsi,
    rbpf,
    rbps_em,
    rts_em,
    simulate,
    standard_errors,
)
from engine.estimation.em import Checkpoint
from engine.estimation.em_loop import Loop, _Log
from engine.filters.proposals import bootstrap
from engine.ties import Ties
from tests.engine.models_for_tests import draw, random_walk, theta_everywhere

MODEL = get_model("linear-2")
SERIES = simulate(MODEL, None, 200, np.random.default_rng(1)).series
SHORT = {"n_particles": 12, "tolerance": None, "seed": 3}


def same_bits(one, other):
    np.testing.assert_array_equal(one.trace, other.trace)
    np.testing.assert_array_equal(one.log_likelihood, other.log_likelihood)
    np.testing.assert_array_equal(one.ess, other.ess)
    np.testing.assert_array_equal(np.asarray(one.theta), np.asarray(other.theta))
    assert (one.outcome, one.message) == (other.outcome, other.message)


def test_agrees_with_exact_em_on_linear_2():
    """Within 0.002; the Monte Carlo error of the averaged iterates is about 0.0003 here."""
    series = SERIES.part(0, 100)
    exact = rts_em(MODEL, series, theta0=[0.3], n_iterations=300, method="em")
    found = rbps_em(MODEL, series, theta0=[0.3], n_particles=25, n_iterations=200, method="em")
    assert exact.outcome is Outcome.CONVERGED
    assert found.outcome is Outcome.CONVERGED
    assert found.outcome.success
    assert found.theta["theta"] == pytest.approx(exact.theta["theta"], abs=0.002)
    assert found.trace.shape == (len(found.log_likelihood) + 1, 1)
    assert found.theta[0] == pytest.approx(found.trace[-20:].mean())  # averaged once settled
    assert np.all(np.diff(exact.log_likelihood) > -1e-9)  # exact EM never descends


@pytest.mark.long
def test_exact_em_ends_once_it_has_settled_and_not_before():
    series = SERIES.part(0, 30)
    found = rts_em(MODEL, series, theta0=[0.3], tolerance=1e-2, n_iterations=50, method="em")
    assert found.outcome is Outcome.CONVERGED
    assert len(found.log_likelihood) < 45
    assert found.theta[0] == pytest.approx(found.trace[-20:].mean())
    few = rts_em(MODEL, series, theta0=[0.3], tolerance=1e-2, n_iterations=3, method="em")
    assert few.outcome is Outcome.ITERATIONS_USED_UP
    assert few.theta[0] == few.trace[-1, 0]


@pytest.mark.long
@pytest.mark.parametrize(
    ("method", "warm_start"),
    [
        ("quasi-newton", True),
        ("em", False),
        pytest.param("quasi-newton", False, marks=pytest.mark.slow),
        pytest.param("em", True, marks=pytest.mark.slow),
    ],
)
def test_resumed_runs_give_the_same_bits(method, warm_start):
    parts = [SERIES.part(0, 40), SERIES.part(40, 100)]
    options = SHORT | {"n_iterations": 8, "method": method, "warm_start": warm_start}
    for series in (parts[0], parts):
        whole = rbps_em(MODEL, series, [0.4], **options)
        for k in (1, 3, 7):
            first = rbps_em(MODEL, series, [0.4], callback=lambda it, k=k: it.k == k, **options)
            assert first.outcome is Outcome.STOPPED_BY_CALLER
            assert len(first.log_likelihood) == k
            same_bits(whole, rbps_em(MODEL, series, resume=first, **options))
            copy = Checkpoint(
                *(
                    np.array(getattr(first, name).tolist())
                    for name in ("trace", "log_likelihood", "ess", "seconds", "collapsed", "memory")
                )
            )
            same_bits(whole, rbps_em(MODEL, series, resume=copy, **options))


@pytest.mark.long
def test_a_run_stopped_after_its_last_iteration_says_the_same():
    """Also where filters were left with one particle: what is said comes from what is kept."""
    y = np.array(SERIES.y[:60])
    y[30] += 40.0
    series, options = Series(y, dt=1.0), SHORT | {"recover": False, "proposal": "bootstrap"}
    whole = rbps_em(MODEL, series, [0.4], n_iterations=4, **options)
    assert "one particle" in whole.message
    for k in (3, 4):
        part = rbps_em(MODEL, series, [0.4], n_iterations=k, **options)
        same_bits(whole, rbps_em(MODEL, series, n_iterations=4, resume=part.checkpoint, **options))


@pytest.mark.long
def test_another_seed_gives_other_numbers():
    one, other = (
        rbps_em(MODEL, SERIES.part(0, 40), n_particles=10, n_iterations=2, seed=s) for s in (1, 2)
    )
    assert not np.array_equal(one.trace[1:], other.trace[1:])


def test_a_callback_sees_every_iteration_and_may_stop_by_exception():
    seen = []

    def callback(it):
        seen.append(it)
        if it.k == 4:
            raise StopIteration

    result = rbps_em(MODEL, SERIES.part(0, 40), n_iterations=9, callback=callback, **SHORT)
    assert [it.k for it in seen] == [1, 2, 3, 4]
    assert result.outcome is Outcome.STOPPED_BY_CALLER
    assert result.outcome.success
    np.testing.assert_array_equal([it.theta[0] for it in seen], result.trace[1:, 0])
    np.testing.assert_array_equal([it.log_likelihood for it in seen], result.log_likelihood)
    assert all(it.seconds > 0 and 1 <= it.ess <= 12 and it.n_iterations == 9 for it in seen)


def test_other_exceptions_of_a_callback_reach_the_caller():
    def callback(it):
        raise RuntimeError("disk full")

    with pytest.raises(RuntimeError, match="disk full"):
        rbps_em(MODEL, SERIES.part(0, 40), n_iterations=2, callback=callback, **SHORT)


@pytest.mark.long
def test_only_the_free_parameters_move():
    model = theta_everywhere()
    series = Series(draw(model, np.zeros((30, 0)), np.arange(30.0), np.random.default_rng(0)))
    result = rbps_em(model, series, free=["R", "f"], n_iterations=3, **SHORT)
    newton = rbps_em(model, series, free=["R", "f"], n_iterations=3, method="em", **SHORT)
    assert not np.array_equal(result.trace, newton.trace)
    held = [k for k, name in enumerate(model.parameter_names) if name not in ("f", "R")]
    np.testing.assert_array_equal(newton.trace[:, held], result.trace[:, held])
    assert result.free == ("f", "R")
    moved = np.any(result.trace != result.trace[0], axis=0)
    assert [name for name, m in zip(model.parameter_names, moved, strict=True) if m] == ["f", "R"]
    nothing = rbps_em(model, series, free=[], n_iterations=2, **SHORT)
    np.testing.assert_array_equal(nothing.trace, nothing.trace[[0, 0, 0]])
    assert "Nothing was estimated" in nothing.message


def test_where_nothing_is_free_one_iteration_does_and_says_so():
    model = random_walk(1e-2)
    found = rbps_em(model, Series(np.zeros(20)), free=[], n_particles=5)
    assert len(found.log_likelihood) == 1
    assert found.outcome.success
    assert found.message.startswith("Nothing was estimated: no parameter is free.")


@pytest.mark.long
def test_iterates_keep_to_the_bounds():
    """The data's level is 3; the parameter c may be 1 at most."""
    y = 3.0 + 0.1 * np.random.default_rng(0).standard_normal(30)
    for how in ({"m_step": "scoring", "method": "em"}, {"m_step": "bfgs", "method": "em"}, {}):
        result = rbps_em(random_walk(1e-4), Series(y), n_iterations=15, **how, **SHORT)
        assert result.trace[:, 0].max() <= 1.0
        assert result.trace[:, 1].min() >= 0.01


@pytest.mark.long
@pytest.mark.parametrize("smoother", ["exact", "algorithm-3"])
@pytest.mark.parametrize("resampling", ["multinomial", "residual"])
def test_all_smoothers_and_schemes_run_to_the_same_place(smoother, resampling):
    exact = rts_em(MODEL, SERIES, n_iterations=5, tolerance=None, method="em")
    found = rbps_em(
        MODEL,
        SERIES,
        n_particles=60,
        n_trajectories=20,
        n_iterations=5,
        smoother=smoother,
        resampling=resampling,
        tolerance=None,
        proposal=bootstrap,
        method="em",
    )
    np.testing.assert_allclose(found.trace, exact.trace, atol=0.01)
    # one estimate has a standard deviation of about 3 here, and a mean lower by half its square
    assert found.log_likelihood.mean() == pytest.approx(exact.log_likelihood.mean(), abs=10.0)


def test_a_custom_proposal_is_called_at_every_row():
    calls = []

    def mine(step):
        calls.append(step.t)
        assert step.mu.shape == (12, 2)
        assert step.y.shape == (1,)
        assert step.theta.theta == 0.1
        return bootstrap(step)

    one = SERIES.part(0, 20)
    f = rbpf(MODEL, None, one, 12, np.random.default_rng(0), proposal=mine)
    g = rbpf(MODEL, None, one, 12, np.random.default_rng(0), proposal="bootstrap")
    assert calls[-19:] == one.t[1:].tolist()
    assert np.isfinite(f.log_likelihood)
    assert f.log_likelihood == pytest.approx(g.log_likelihood, abs=5.0)


def test_a_collapse_is_reported_with_its_time():
    """A value 40 standard deviations off, and a filter that is blind to it."""
    y = np.array(SERIES.y[:30])
    y[17] += 40.0
    f = rbpf(MODEL, None, Series(y), 200, np.random.default_rng(0), proposal="bootstrap")
    assert 17 in f.collapsed
    assert f.ess[17] < 1.5
    clean = rbpf(MODEL, None, SERIES.part(0, 30), 200, np.random.default_rng(0))
    assert clean.collapsed.size == 0
    s = rb_ffbsi(f, 10, np.random.default_rng(0))
    assert np.isfinite(s.mean()).all()


def test_a_filter_that_stays_collapsed_makes_the_run_lost():
    """Measurements far more precise than any of 8 blind particles can be."""
    y = np.random.default_rng(0).standard_normal(40).cumsum()
    model = random_walk(1.0)
    sharp = replace(
        model, measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[1e-10]])
    )
    options = {"n_particles": 8, "n_iterations": 2, "proposal": "bootstrap", "recover": False}
    result = rbps_em(sharp, Series(y), **options)
    assert result.outcome is Outcome.COLLAPSED
    assert not result.outcome.success
    assert "% of the rows" in result.message
    assert result.collapsed.min() > 0.5


@pytest.mark.parametrize("estimate", [rbps_em, rts_em, ps_em])
def test_readings_that_do_not_tell_the_parameters_are_refused(estimate):
    """They can all be met exactly: the likelihood has no maximum."""
    model = get_model("local-level")
    free = ["q", "r", "level"]
    series = Series([1.0, np.nan, 2.0, 0.5])
    with pytest.raises(SeriesError, match="3 readings do not tell 3 parameters: give more data"):
        estimate(model, series, free=free)
    estimate(model, series, free=free[:2], n_iterations=1)
    with pytest.raises(SeriesError, match="2 readings do not tell 3 parameters"):
        estimate(model, [Series([1.0, np.nan]), Series([2.0, np.nan])], free=free)


@pytest.mark.parametrize(
    ("collapsed", "lost", "told"),
    [
        ([0.6, *[0.0] * 7], False, ""),
        ([0.0] * 4 + [0.004] * 4, False, ""),
        ([0.0] * 4 + [0.02] * 4, False, " at 2.0 % of the rows"),
        ([0.0] * 4 + [0.2] * 4, True, " at 20.0 % of the rows"),
        ([0.6], True, " at 60.0 % of the rows"),
    ],
)
def test_only_the_end_makes_a_run_lost(collapsed, lost, told):
    """A first E step at a bad start, from which the run came away, does not; a row in a thousand is no word."""
    log = _Log(MODEL, Loop(), 0)
    log.trace = [MODEL.theta()] * (len(collapsed) + 1)
    log.rows = [(-80.0, 9.0, 0.1, share) for share in collapsed]
    log.memory = [None] * len(collapsed)
    found = log.result(("theta",), Outcome.ITERATIONS_USED_UP, None, Ties())
    assert (found.outcome is Outcome.COLLAPSED) == lost
    assert told in found.message
    assert told or "of the rows" not in found.message


def test_a_run_that_is_no_longer_finite_has_diverged():
    """The dynamics return NaN at a time: the log-likelihood is not finite, theta stays where it was."""
    model = random_walk()

    def dynamics(a, u, t, dt, theta):
        return [np.where(np.equal(t, 6.0), np.nan, 1.0) * a[:, 0]], np.zeros((1, 0)), [[0.1]]

    broken = replace(model, dynamics=dynamics)
    result = rbps_em(broken, SERIES.part(0, 20), n_iterations=5, recover=False)
    assert result.outcome is Outcome.DIVERGED
    assert result.not_estimated == ()
    assert not result.outcome.success
    assert len(result.log_likelihood) == 1
    np.testing.assert_array_equal(result.trace[0], result.trace[1])


@pytest.mark.long
def test_the_log_likelihood_is_printed_with_its_monte_carlo_error():
    series = SERIES.part(0, 100)
    settled = rbps_em(MODEL, series, [0.3], n_particles=25, n_iterations=200, method="em")
    rng = np.random.default_rng(0)
    runs = [rbpf(MODEL, settled.theta, series, 25, rng).log_likelihood for _ in range(100)]
    assert settled.log_likelihood_error == pytest.approx(
        np.std(runs, ddof=1), rel=0.5
    )  # 20 numbers
    said = f"{settled.log_likelihood[-1]:.2f} +- {settled.log_likelihood_error:.2g} (Monte Carlo"
    assert said in str(settled)
    few = rbps_em(MODEL, series, [0.3], n_iterations=2, **SHORT)
    assert few.log_likelihood_error is None
    assert f"about {few.log_likelihood[-1]:.2f}, by one particle filter" in str(few)
    rising = replace(
        settled, log_likelihood=settled.log_likelihood + np.arange(float(settled.ess.size))
    )
    assert rising.log_likelihood_error is None
    exact = rts_em(MODEL, series, [0.3], n_iterations=2)
    assert exact.log_likelihood_error == 0.0
    assert f"iteration: {exact.log_likelihood[-1]:.2f}." in str(exact)


def test_the_log_likelihood_of_a_model_without_nonlinear_states_is_exact():
    decay = continuous(
        name="decay",
        drift=lambda a, u, t, theta: ([0.0], [[-theta.k]]),
        diffusion=lambda a, u, t, theta: [[0.1]],
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[0.1]]),
        initial=lambda theta: (None, [1.0], [[1.0]]),
        linear={"x": "1"},
        outputs={"y": "1"},
        parameters=[Parameter("k", 0.5, "1/s", (0.0, 5.0))],
    )
    series = simulate(decay, None, 30, np.random.default_rng(1)).series
    found = rbps_em(decay, series, n_iterations=2, **SHORT)
    assert found.log_likelihood_error == 0.0
    assert f"iteration: {found.log_likelihood[-1]:.2f}." in str(found)
    at = found.trace[len(found.log_likelihood) - 1]
    exact = kalman_smoother(decay, at, series).log_likelihood
    assert found.log_likelihood[-1] == pytest.approx(exact)


@pytest.mark.long
def test_a_parameter_that_acts_in_a_later_record_only_is_estimated_from_it():
    """Whatever comes first: it was held where the first record did not need it, and the noise grew instead."""

    def dynamics(a, u, t, dt, th):
        return [th.k if dt > 0.5 else 0.0], [[0.9]], [[0.01]]

    model = MixedModel(
        name="slow",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([0.0], [[1.0]], [[th.r]]),
        initial=lambda th: (None, [0.0], [[1.0]]),
        linear={"x": "1"},
        outputs={"y": "1"},
        parameters=[Parameter("k", 0.1, "1", (-5.0, 5.0)), Parameter("r", 0.05, "1", (1e-4, 5.0))],
    )
    truth = {"k": 1.0, "r": 0.1}
    fast, slow = (
        simulate(model, truth, 100, np.random.default_rng(seed), dt=dt).series
        for seed, dt in ((1, 0.1), (2, 1.0))
    )
    found = [rts_em(model, records) for records in ([fast, slow], [slow, fast])]
    for fit in found:
        assert fit.theta["k"] == pytest.approx(1.0, abs=0.04)
        assert fit.theta["r"] == pytest.approx(0.1, abs=0.03)
    np.testing.assert_allclose(found[0].theta, found[1].theta, rtol=1e-4)
    errors = standard_errors(model, found[0], [fast, slow], exact=True)
    assert 0.0 < np.sqrt(errors.covariance[0, 0]) < 0.03


@pytest.mark.parametrize("estimate", [rbps_em, rts_em, ps_em])
@pytest.mark.parametrize("tolerance", [-1.0, np.nan])
def test_a_tolerance_within_which_nothing_settles_is_refused(estimate, tolerance):
    series = Series([1.0, 2.0, 0.5, 1.5])
    with pytest.raises(OptionError, match=r"tolerance = .*; a number from 0 on is needed"):
        estimate(get_model("local-level"), series, tolerance=tolerance)
