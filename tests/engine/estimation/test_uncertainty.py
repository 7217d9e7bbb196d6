"""Printed uncertainties are what they are called: against their spread over seeds, and by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

import engine
from engine.data import nile
from engine.errors import NotSettledWarning
from engine.estimation.em_result import EmResult
from engine.estimation.likelihood_step import LikelihoodStep
from engine.estimation.outcome import Outcome
from engine.estimation.quasi_ml import quasi_ml
from engine.estimation.uncertainty import StandardErrors, likelihood, observed, standard_errors
from engine.estimation.uncertainty.profile import March
from engine.estimation.uncertainty.roots import relative_errors
from engine.estimation.uncertainty.score import Score

MODEL = engine.get_model("linear-2")
SERIES = engine.simulate(MODEL, None, 40, np.random.default_rng(4)).series
LONG = engine.simulate(MODEL, {"theta": 0.4}, 150, np.random.default_rng(3)).series
SMALL = {"n_particles": 12, "n_trajectories": 12}


@pytest.fixture(scope="module")
def best():
    return quasi_ml(MODEL, SERIES).theta


@pytest.fixture(scope="module")
def top():
    return quasi_ml(MODEL, LONG, {"theta": 0.4}).theta


def errors_with(theta=0.0, variance=1.0):
    return StandardErrors(
        MODEL,
        MODEL.theta([theta]),
        ("theta",),
        np.array([[variance]]),
        np.zeros(1),
        np.zeros(1),
        np.zeros(1),
    )


@pytest.mark.parametrize("level", [0.5, 0.6827, 0.95, 0.99])
def test_an_interval_has_its_confidence(level):
    """The share of a normal distribution between the ends, computed from the ends."""
    low, high = errors_with(0.25, 0.09).interval(level)[0]
    assert norm.cdf(high, 0.25, 0.3) - norm.cdf(low, 0.25, 0.3) == pytest.approx(level, abs=1e-9)
    assert low + high == pytest.approx(0.5)


def test_an_interval_ends_at_the_bounds():
    """No variance is negative; ends that are not there stay away."""
    model = engine.get_model("local-level")  # q and r in [0, inf)
    errors = StandardErrors(
        model,
        model.theta({"q": 2.0, "r": 1.0}),
        ("q", "r"),
        np.diag([4.0, 0.01]),
        *np.zeros((3, 2)),
    )
    low, high = errors.interval()[:2].T
    assert low[0] == 0.0
    assert high[0] == pytest.approx(2.0 + 1.96 * 2.0, abs=1e-3)
    assert (low[1], high[1]) == pytest.approx((1.0 - 0.196, 1.0 + 0.196), abs=1e-3)
    assert np.isinf(replace(errors, tied=("q",)).interval()[0]).all()


@pytest.mark.long
@pytest.mark.parametrize("by", [{"exact": True}, SMALL])
@pytest.mark.parametrize("q", [1e-9, 1e-4, 0.1])
def test_a_variance_next_to_its_bound_leaves_the_errors_of_others_alone(q, by):
    """Of the Nile with its step the likelihood rises up to q = 0, by less than half a nat from these.

    Scores by particles drown there: once an interval of q was 10,000 times too narrow, without a word.
    """
    model = engine.get_model("local-level", effects=["step:flow"])
    told = {"q": 0.0, "r": 16000.0, "level": 1098.0, "step_flow": -248.0, "step_flow_time": 1899.0}
    free = ["q", "r", "level", "step_flow"]
    at = model.theta(quasi_ml(model, nile(), told, free).theta).asdict()
    assert at["q"] == 0.0
    exact = standard_errors(model, at, nile(), free, exact=True)
    near = standard_errors(model, {**at, "q": q}, nile(), free, **by)
    assert near.names == exact.names == ("r", "level", "step_flow")
    assert "up to the bound of q" in near.warning
    assert near.settled
    rtol = 0.02 if "exact" in by else 0.3
    np.testing.assert_allclose(near.values[[1, 2, 3]], exact.values[[1, 2, 3]], rtol=rtol)


@pytest.mark.long
def test_a_variance_that_is_small_for_good_keeps_its_error():
    """Of the Nile without its step q has a maximum, a tenth of r."""
    model = engine.get_model("local-level")
    best = quasi_ml(model, nile()).theta
    errors = standard_errors(model, best, nile(), exact=True)
    assert errors.names[0] == "q"
    low = standard_errors(model, {**best.asdict(), "q": 0.9 * best["q"]}, nile(), exact=True)
    assert low.names[0] == "q"


def test_errors_that_are_badly_known_are_said_to_be():
    assert observed._said_of_noise(np.array([0.1, 0.2])) == ""
    assert "errors themselves may be 89 % off" in observed._said_of_noise(np.array([0.1, 0.89]))


def test_every_iteration_of_em_has_random_numbers_of_its_own():
    """Iteration k draws from SeedSequence(seed, spawn_key=(k,)), and k alone."""
    seen = []

    def proposal(step):
        if step.t == SERIES.t[0]:
            seen.append(step.rng.bit_generator.state["state"]["state"])
        return engine.filters.proposals.bootstrap(step)

    engine.rbps_em(
        MODEL,
        SERIES,
        n_particles=5,
        n_iterations=4,
        seed=7,
        warm_start=False,
        proposal=proposal,
        recover=False,
    )
    expected = [
        np.random.default_rng(np.random.SeedSequence(7, spawn_key=(k,))) for k in (1, 2, 3, 4)
    ]
    assert seen == [rng.bit_generator.state["state"]["state"] for rng in expected]
    assert len(set(seen)) == 4


@pytest.fixture(scope="module")
def many(best):
    """Standard errors at the maximum with 16 seeds, 9 smoothers each."""
    return [
        engine.standard_errors(MODEL, best, SERIES, replicates=9, seed=s, **SMALL)
        for s in range(16)
    ]


@pytest.mark.slow
def test_the_error_of_the_score_is_its_spread_over_seeds(many):
    """A standard deviation from 16 numbers is off by 18 %; outside these limits 1 time in 1000."""
    spread = np.std([one.score[0] for one in many], ddof=1)
    stated = np.sqrt(np.mean([one.score_error[0] ** 2 for one in many]))
    assert 0.5 < spread / stated < 1.7


@pytest.mark.long
def test_the_error_of_standard_errors_is_their_spread_over_seeds(many):
    """As above; the jackknife's own noise comes on top."""
    spread = np.std(np.log([one.values[0] for one in many]), ddof=1)
    stated = np.sqrt(np.mean([one.relative_error[0] ** 2 for one in many]))
    assert 0.4 < spread / stated < 2.0


@pytest.mark.long
def test_standard_errors_are_those_of_the_exact_likelihood(many, best):
    """The Kalman filter's log-likelihood at three points knows its own curvature."""
    found = engine.standard_errors(MODEL, best, SERIES, exact=True).values[0]
    h = 0.5 * found  # the length of the differences
    low, top, high = (
        engine.kalman_smoother(MODEL, best["theta"] + s, SERIES).log_likelihood
        for s in (-h, 0.0, h)
    )
    exact = h / np.sqrt(2.0 * top - low - high)
    assert found == pytest.approx(exact, rel=0.05)
    each = np.array([one.values[0] for one in many])
    assert np.abs(each.mean() / exact - 1.0) < 0.15  # 12 particles have a bias


@pytest.fixture
def asked(monkeypatch):
    """How often a score was asked for."""
    calls, at = [], Score.at

    def counted(self, x, seed):
        calls.append(x)
        return at(self, x, seed)

    monkeypatch.setattr(Score, "at", counted)
    return calls


@pytest.mark.long
def test_without_nonlinear_states_nothing_is_drawn():
    """Particles repeated one another there: a converter's errors took 110 s, and take 16."""
    level, series = engine.get_model("local-level"), nile()
    free = ["q", "r"]
    best = quasi_ml(level, series, free=free).theta
    exact = engine.standard_errors(level, best, series, free, exact=True)
    for seed in (0, 1):
        found = engine.standard_errors(level, best, series, free, seed=seed)
        np.testing.assert_array_equal(found.covariance, exact.covariance)
        assert not found.relative_error.any()


@pytest.mark.long
def test_the_moment_filters_information_saves_smoothers(asked, best):
    exact = engine.standard_errors(MODEL, best, SERIES, exact=True).values[0]
    asked.clear()
    each = [engine.standard_errors(MODEL, best, SERIES, seed=s, **SMALL) for s in range(8)]
    assert 8 * (4 + 2 * 2) <= len(asked) <= 8 * (4 + 4 * 2)
    found = np.array([one.values[0] for one in each])
    np.testing.assert_allclose(found, exact, rtol=0.15)


@pytest.mark.parametrize("times", [None, 0.2])
def test_where_it_is_no_guide_differences_alone_count(times, monkeypatch, best):
    """Not to be had, or far off."""
    own = LikelihoodStep.information

    def off(self, theta, indices):
        return None if times is None else times * own(self, theta, indices)

    alone = engine.standard_errors(MODEL, best, SERIES, seed=1, replicates=8, **SMALL)
    monkeypatch.setattr(LikelihoodStep, "information", off)
    found = engine.standard_errors(MODEL, best, SERIES, seed=1, **SMALL)
    np.testing.assert_allclose(found.covariance, alone.covariance, rtol=0.02)


@pytest.mark.long
@pytest.mark.parametrize("times", [3.0, 20.0])
def test_one_that_claims_too_much_is_corrected(times, monkeypatch, best):
    own = LikelihoodStep.information
    exact = engine.standard_errors(MODEL, best, SERIES, exact=True).values[0]
    monkeypatch.setattr(LikelihoodStep, "information", lambda *at: times * own(*at))
    for seed in range(4):
        found = engine.standard_errors(MODEL, best, SERIES, seed=seed, **SMALL)
        assert found.values[0] == pytest.approx(exact, rel=0.15)


@pytest.fixture(scope="module")
def ridge():
    """A fuel cell's voltage: A ln(i0) is known far better than A or i0, and i0 to a third.

    With the maximum and the inverse of a Hessian by short differences, in the logarithms.
    """
    rng = np.random.default_rng(3)
    i = rng.uniform(0.05, 1.1, 120)
    model = engine.MixedModel(
        name="cell",
        linear={"w": "Ohm"},
        inputs={"i": "A"},
        outputs={"U": "V"},
        dynamics=lambda a, u, t, dt, th: ([0.0], [[0.9]], [[1e-5]]),
        measurement=lambda a, u, t, th: (
            [1.18 - th.A * np.log(u[0] / th.i0) - th.R0 * u[0]], [[-u[0]]], [[4e-6]]
        ),
        initial=lambda th: (None, [0.0], [[5e-5]]),
        parameters=[
            engine.Parameter("A", 0.026, "V", (0.005, 0.2)),
            engine.Parameter("i0", 3e-7, "A", (1e-10, 1e-3)),
            engine.Parameter("R0", 0.15, "Ohm", (0.0, 2.0)),
        ],
    )  # fmt: skip
    series = engine.simulate(model, None, 120, rng, u=i).series
    at = quasi_ml(model, series, tolerance=1e-8).theta
    steps = 1e-3 * np.eye(3)

    def value(logs):
        return engine.kalman_smoother(model, np.exp(logs), series).log_likelihood

    x = np.log(np.asarray(at))
    H = [
        [(value(x + j + k) - value(x + j - k) - value(x - j + k) + value(x - j - k)) for j in steps]
        for k in steps
    ]
    inverse = np.linalg.inv(-np.array(H) / (4.0 * 1e-6))
    return model, series, at, np.asarray(at) * np.sqrt(np.diag(inverse))


@pytest.mark.long
@pytest.mark.parametrize("options", [{"exact": True}, {}, {"replicates": 2}])
def test_on_a_curved_ridge_the_errors_are_those_at_the_maximum(options, ridge):
    """Half an error along a straight line leaves the ridge, and sees twice the information."""
    model, series, at, errors = ridge
    found = engine.standard_errors(model, at, series, **{**SMALL, **options})
    np.testing.assert_allclose(found.values, errors, rtol=0.03)
    assert found.settled


@pytest.mark.slow
def test_along_a_curved_ridge_intervals_end_where_the_profile_has_fallen(ridge):
    model, series, at, _ = ridge
    found = engine.likelihood_intervals(model, at, series, exact=True)
    assert not found.warning
    top = quasi_ml(model, series, at, tolerance=1e-8).log_likelihood
    for name, value, (low, high) in zip(at.names, at.tolist(), found.values, strict=True):
        assert low < value < high
        others = [other for other in at.names if other != name]
        for end in (low, high):
            held = quasi_ml(model, series, {**at.asdict(), name: end}, others, tolerance=1e-8)
            assert top - held.log_likelihood == pytest.approx(1.92, abs=0.05)


@pytest.mark.long
def test_ends_to_which_there_is_no_way_are_not_found(monkeypatch, best):
    """And not the parameter's bound, which would say that the likelihood does not fall."""
    sd = engine.standard_errors(MODEL, best, SERIES, exact=True).values[0]
    own = Score.at

    def lost(self, x, seed):
        if x[0] > best["theta"] + 1.5 * sd:
            raise engine.ModelError("the likelihood is not finite here")
        return own(self, x, seed)

    errors = engine.standard_errors(MODEL, best, SERIES, exact=True)
    whole = engine.likelihood_intervals(MODEL, best, SERIES, errors=errors, exact=True)
    monkeypatch.setattr(Score, "at", lost)
    with pytest.warns(NotSettledWarning, match=r"Not found: the interval of theta \(upper end\)"):
        found = engine.likelihood_intervals(MODEL, best, SERIES, errors=errors, exact=True)
    assert np.isnan(found.values[0, 1])
    assert found.values[0, 0] == pytest.approx(whole.values[0, 0], rel=1e-3)
    assert "not found" in found._repr_html_()
    monkeypatch.setattr(March, "_at", lambda *asked: None)
    with pytest.warns(NotSettledWarning, match="Not found: the interval of theta,"):
        found = engine.likelihood_intervals(MODEL, best, SERIES, errors=errors, exact=True)
    assert np.isnan(found.values[0]).all()


def test_a_score_far_from_zero_is_no_maximum_however_badly_its_errors_are_known():
    """Eighteen times its noise, with a covariance that noise has made small or huge."""
    scores = np.array([-68.0, 0.2]) + np.array([[-7.0, 1.0], [-2.0, -1.0], [2.0, 1.0], [7.0, -1.0]])
    complete = np.array([6700.0, 100.0])
    assert observed._surely_away(scores, complete) == pytest.approx(68.0**2 / 6700.0)
    assert observed._surely_away(scores, 100.0 * complete) == 0.0
    assert observed._surely_away(scores - scores.mean(axis=0), complete) == 0.0
    assert observed._doubtful(8.3, 9.0, 4)  # hidden by the noise of four scores
    assert observed._doubtful(1.0, 0.5, 4)  # perhaps by their noise
    assert not observed._doubtful(1.0, 9.0, 4)  # as much as noise makes on average
    assert not observed._doubtful(20.0, 9.0, 16)


@pytest.mark.long
def test_a_distance_that_a_wrong_covariance_hides_is_told(top, monkeypatch):
    """The covariance is taken for far too small: its decrement says nothing."""
    sd = engine.standard_errors(MODEL, top, LONG, exact=True).values[0]
    small = np.array([[1e-3 * sd**2]]), np.zeros(1), ""
    monkeypatch.setattr(observed, "_differences", lambda *asked: small)
    with pytest.warns(NotSettledWarning):
        found = engine.standard_errors(MODEL, top["theta"] + 4.0 * sd, LONG, exact=True)
    assert not found.settled
    assert found.decrement > 0.25


@pytest.mark.parametrize("R", [2, 5])
def test_the_error_of_the_score_is_that_of_a_mean(R, best):
    """Exactly, from the scores of the same smoothers."""
    seeds = np.random.SeedSequence(3).spawn(R)
    free = np.array([0])
    score = Score.of(MODEL, best, [SERIES], free, 12, 12, exact=False)
    each = np.array([score.at(score.x, which)[0][0] for which in seeds])
    found = engine.standard_errors(MODEL, best, SERIES, replicates=R, seed=3, **SMALL)
    assert found.score[0] == pytest.approx(each.mean())
    assert found.score_error[0] == pytest.approx(each.std(ddof=1) / np.sqrt(R))
    assert found.decrement == pytest.approx(each.mean() ** 2 * found.covariance[0, 0])


@pytest.mark.long
def test_settled_is_within_half_a_standard_error(top):
    """And the limit grows with the noise of the score: 0.25 + t^2 times its variance in those errors."""
    variance = np.array([[4.0]])
    decrement, noise = observed.score_decrement(variance, np.array([[0.3]]))
    assert (decrement, noise) == (pytest.approx(0.36), 0.0)
    scores = np.array([[0.1], [0.5]])
    decrement, noise = observed.score_decrement(variance, scores)
    assert decrement == pytest.approx(0.36)
    assert noise == pytest.approx(4.0 * (0.08 / 2.0) * 12.7062**2, rel=1e-4)
    sd = engine.standard_errors(MODEL, top, LONG, exact=True).values[0]
    assert engine.standard_errors(MODEL, top["theta"] + 0.4 * sd, LONG, exact=True).settled
    with pytest.warns(NotSettledWarning) as told:
        engine.standard_errors(MODEL, top["theta"] + 0.65 * sd, LONG, exact=True)
    assert told[0].filename == __file__  # it points to the caller


def test_the_jackknife_of_a_mean_is_its_standard_error():
    """Exact for statistics that are linear in the replicates; these nearly are."""
    R = 7
    e = 1e-5 * np.random.default_rng(0).standard_normal(R)
    found = relative_errors(np.eye(1), (1.0 + e)[:, None, None])
    assert found[0] == pytest.approx(0.5 * e.std(ddof=1) / np.sqrt(R), rel=1e-3)
    at = np.linspace(-4.0, 4.0, 33)
    slopes = -(at - e[:, None])  # parabolas with their tops at e
    found = likelihood._jackknife(at, slopes, 0.0, 2.0, (-4.0, 4.0))
    np.testing.assert_allclose(found, e.std(ddof=1) / np.sqrt(R), rtol=1e-2)
    assert relative_errors(np.eye(1), np.ones((1, 1, 1)))[0] == 0.0


@pytest.mark.slow
def test_the_errors_of_interval_ends_are_their_spread_over_seeds(best):
    """12 seeds: outside these limits less than 1 time in 100."""
    errors = engine.standard_errors(MODEL, best, SERIES, exact=True)
    found = [
        engine.likelihood_intervals(MODEL, best, SERIES, errors=errors, seed=s, **SMALL)
        for s in range(12)
    ]
    spread = np.std([one.values[0] for one in found], axis=0, ddof=1)
    stated = np.sqrt(np.mean([one.errors[0] ** 2 for one in found], axis=0))
    assert (spread / stated > 0.4).all()
    assert (spread / stated < 2.2).all()


# ---- estimates that have not settled --------------------------------------------------------------


def test_at_the_maximum_nothing_is_said(many, best):
    """Also with particles, whose scores are never quite zero: none of 16."""
    assert [one.settled for one in many] == [True] * 16
    assert {one.warning for one in many} == {""}
    exact = engine.standard_errors(MODEL, best, SERIES, exact=True)
    assert exact.settled
    assert exact.decrement < 2e-3  # quasi_ml stops when 1e-3 nats are left, of which this is twice


@pytest.mark.long
@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("shift", [-3.0, 3.0])
def test_away_from_the_maximum_the_distance_is_told(exact, shift, top):
    """The decrement is the squared distance in standard errors, as far as the likelihood is a parabola."""
    sd = engine.standard_errors(MODEL, top, LONG, exact=True).values[0]
    options = {"exact": True} if exact else {"replicates": 4, **SMALL}
    with pytest.warns(NotSettledWarning, match="the likelihood rises from here"):
        found = engine.standard_errors(MODEL, top["theta"] + shift * sd, LONG, **options)
    assert not found.settled
    assert 1.0 < found.decrement < 60.0
    for text in (str(found), found._repr_html_()):
        assert "no standard errors of an estimate" in text
    assert "theta = " in str(found)


def test_an_estimation_that_ran_out_of_iterations_is_named(best):
    start = MODEL.theta([best["theta"] + 0.3])
    trace = np.array([[start[0]]])
    found = EmResult(
        MODEL, ("theta",), start, trace, *(np.empty(0),) * 4,
        Outcome.ITERATIONS_USED_UP, Outcome.ITERATIONS_USED_UP.value,
    )  # fmt: skip
    with pytest.warns(NotSettledWarning, match="The estimation said: Iterations used up"):
        errors = engine.standard_errors(MODEL, found, SERIES, exact=True)
    document = engine.examine(found, SERIES, errors).to_dict()
    assert document["warning"] == errors.warning
    report = engine.presentation.report.estimate.estimate_report(document, lambda chart: "")
    assert "no standard errors of an estimate" in str(report)


@pytest.mark.long
def test_a_bound_that_the_likelihood_draws_away_from_is_named():
    """At its bound a parameter is held; if the maximum is inside, the others' errors mean nothing."""
    model = engine.get_model("local-level")
    series = engine.simulate(model, None, 60, np.random.default_rng(0)).series
    lower = dict(zip(model.parameter_names, model.lower.tolist(), strict=True))
    best = quasi_ml(model, series, free=["q", "r"]).theta
    assert best["q"] > lower["q"]
    settled = engine.standard_errors(model, best, series, ["q", "r"], exact=True)
    assert settled.settled
    at = {**best.asdict(), "q": lower["q"] if lower["q"] > 0 else 1e-12}
    with pytest.warns(NotSettledWarning):
        found = engine.standard_errors(model, at, series, ["q", "r"], exact=True)
    assert not found.settled


@pytest.mark.parametrize(("x", "sign"), [(0.0, 1.0), (1.0, -1.0)])
def test_how_strongly_a_bound_must_be_left(x, sign):
    """Half a standard error of complete data, beyond the noise of the score."""
    score = SimpleNamespace(x=np.array([x]), bounds=(np.zeros(1), np.ones(1)), names=("k",))
    for pull, inside, beyond in ((6.0, ["k"], []), (4.0, [], []), (-6.0, [], ["k"])):
        scores = np.full((4, 1), sign * pull)
        assert observed._drawn_at_bounds(score, scores, np.array([100.0])) == (inside, beyond)
    noisy = sign * np.array([[0.0], [12.0]])
    assert observed._drawn_at_bounds(score, noisy, np.array([100.0])) == ([], [])
    score.x = np.array([0.5])
    assert observed._drawn_at_bounds(score, np.full((4, 1), 9.0), np.array([100.0])) == ([], [])


@pytest.mark.long
def test_errors_beside_a_variance_that_its_bound_keeps_too_small_say_so():
    model = engine.get_model("local-level")
    series = engine.simulate(model, None, 200, np.random.default_rng(0)).series
    best = quasi_ml(model, series, free=["q", "r"]).theta
    narrow = [
        replace(p, bounds=(p.bounds[0], 0.3 * best["r"]), default=0.2 * best["r"])
        if p.name == "r"
        else p
        for p in model.parameters
    ]
    bounded = model.with_parameters(narrow)
    found = engine.rts_em(bounded, series, free=["q", "r"])
    assert found.theta["r"] == pytest.approx(0.3 * best["r"])
    errors = engine.standard_errors(bounded, found.theta, series, ["q", "r"], exact=True)
    assert "The data draw r beyond the bound" in errors.warning
    free = engine.standard_errors(model, best, series, ["q", "r"], exact=True)
    assert "beyond the bound" not in free.warning


@pytest.mark.long
def test_intervals_about_another_maximum_say_so(top):
    sd = engine.standard_errors(MODEL, top, LONG, exact=True).values[0]
    with pytest.warns(NotSettledWarning, match="The likelihood is highest at theta"):
        found = engine.likelihood_intervals(MODEL, top["theta"] + 2.0 * sd, LONG, exact=True)
    assert found.maximum[0] == pytest.approx(top["theta"], abs=0.1 * sd)
    assert "highest" in found._repr_html_()


class Sloped:
    """A score with slope -``held`` in every direction and noise, about which a guess says 1."""

    whose = "the moment filter's"

    def __init__(self, noise, held=1.0, n=3):
        self.noise, self.held, self.x, self.calls = noise, held, np.zeros(n), 0
        self.theta, self.indices = np.zeros(n), np.arange(n)
        self.bounds = np.full(n, -np.inf), np.full(n, np.inf)
        self.likelihood, self.exact = self, False

    def information(self, theta, indices):
        return np.eye(len(indices))

    def values(self, points):
        return -0.5 * (points**2).sum(axis=-1)

    def at(self, x, which):
        self.calls += 1
        rng = np.random.default_rng([self.calls, 7])
        return -self.held * x + self.noise * rng.standard_normal(len(x)), None


@pytest.mark.parametrize(
    ("noise", "held", "rounds", "said"),
    [(5.0, 1.0, 1, "alone"), (0.01, 1.0, 2, ""), (0.3, 1.0, 4, ""), (5.0, 200.0, 4, None)],
)
def test_no_more_differences_are_made_than_it_takes(noise, held, rounds, said):
    """None at all where they drown in noise, unless they show that the guess is wide of the mark."""
    score = Sloped(noise, held)
    scores = noise * np.random.default_rng(3).standard_normal((4, 3))
    seeds = np.random.SeedSequence(0).spawn(4)
    found = observed._guessed(score, 10.0 * np.eye(3), seeds, scores)
    assert score.calls == rounds * 2 * 3
    if said is None:
        assert found is None  # the guess is given up
        return
    covariance, relative, words = found
    assert (said in words) if said else not words
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), 1.0, rtol=0.2)
    assert (relative <= 0.2).all()


@pytest.mark.parametrize("seed", [1, 3, 10])
def test_scores_that_drown_next_to_a_bound_make_no_error_of_it(seed):
    """Of noise about a level that stays: once q had the error of a floor, 1e-4 of what the data allow."""
    level = engine.get_model("local-level")
    series = engine.Series(1000.0 + 100.0 * np.random.default_rng(seed).standard_normal(60))
    best = quasi_ml(level, series, {"q": 0.0, "r": 1e4, "level": 1000.0}, ["q", "r"]).theta
    assert best["q"] == 0.0
    at = {**best.asdict(), "q": 1e-8}
    held = standard_errors(level, best, series, ["q", "r"], **SMALL)
    near = standard_errors(level, at, series, ["q", "r"], **SMALL)
    assert near.names == held.names == ("r",)
    np.testing.assert_allclose(near.values[1], held.values[1], rtol=0.05)


@pytest.mark.long
@pytest.mark.parametrize("outcome", [Outcome.COLLAPSED, Outcome.DIVERGED, Outcome.WANDERED])
def test_errors_at_the_end_of_a_lost_estimation_are_said_to_be_none(outcome, best):
    """A score that is zero there made them "settled", and of a lost run c = 0.002 +- 4.5e-07 was printed."""
    trace = np.array([[best[0]]])
    found = EmResult(
        MODEL, ("theta",), best, trace, *(np.empty(0),) * 4, outcome, outcome.value
    )  # fmt: skip
    if outcome.success:
        errors = engine.standard_errors(MODEL, found, SERIES, exact=True)
        assert errors.settled
        assert "The estimation itself was not sure that this is a maximum" in errors.warning
        return
    with pytest.warns(NotSettledWarning, match="There is no estimate"):
        errors = engine.standard_errors(MODEL, found, SERIES, exact=True)
    assert not errors.settled
    with pytest.warns(NotSettledWarning, match="There is no estimate"):
        intervals = engine.likelihood_intervals(MODEL, found, SERIES, errors=errors, exact=True)
    assert outcome.value in intervals.warning
