"""The filter that knows outliers: the moment filter without them, the particle filter with them."""

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student_t

import engine
from engine.data.joined import together
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.screening.tails import fit_tails
from engine.estimation.quasi_ml import quasi_ml
from engine.filters import strata
from engine.filters.heavy_tails import with_mixture, with_student_t
from engine.filters.sigma_point import moment_filter, moment_path
from tests.engine.estimation.test_particle_likelihood import decay, mixture, most_likely, record
from tests.engine.hidden_effects import DRIVE, hidden

THETA = np.asarray(DRIVE.theta())


def outlier_log_terms(model, thetas, series, channel, shares, ratios):
    """One-step log-densities (T, K) with these shares and ratios of outliers in a channel."""
    where = "measurement" if channel in model.outputs else "dynamics"
    known = with_mixture(model, where, channels=[channel])
    each = np.broadcast_to(thetas, (len(shares), len(model.parameters)))
    return moment_filter(known, np.column_stack([each, shares, ratios]), series).log_terms


@pytest.mark.parametrize("channel", ["reading", "speed", "load"])
def test_without_outliers_it_is_the_moment_filter(channel):
    series = hidden([], {}, 1)
    base = moment_filter(DRIVE, THETA[None], series).log_terms
    shares, ratios = np.array([1e-12, 0.3]), np.array([10.0, 1.0])
    terms = outlier_log_terms(DRIVE, THETA, series, channel, shares, ratios)
    np.testing.assert_allclose(terms, np.repeat(base, 2, axis=1), rtol=1e-6, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("channel", "where"), [("reading", "measurement"), ("speed", "dynamics")])
def test_with_outliers_it_is_the_particle_filter(channel, where):
    """Within 1.5 nats of what 2000 particles say."""
    model = with_mixture(DRIVE, where, channels=[channel])
    values = {"outlier_share": 0.05, "outlier_ratio": 6.0}
    rng = np.random.default_rng(2)
    u = np.repeat(rng.uniform(-2.0, 2.0, 20), 20)
    series = engine.simulate(model, values, 400, rng, u=u, dt=0.1).series
    base = moment_filter(DRIVE, THETA[None], series).log_likelihood[0]
    terms = outlier_log_terms(DRIVE, THETA, series, channel, np.array([0.05]), np.array([6.0]))
    assert terms.sum() > base + 5.0
    runs = [
        engine.rbpf(
            model, model.theta(values), series, 2000, np.random.default_rng(k)
        ).log_likelihood
        for k in range(3)
    ]
    assert terms.sum() == pytest.approx(np.mean(runs), abs=1.5)


def test_one_jump_is_no_heavy_tail():
    """A pulse in the state's equation gains little as outliers of the sensor."""
    values = {"pulse_speed": 6.0, "pulse_speed_time": 20.0, "pulse_speed_width": 0.1}
    series = hidden(["pulse:speed"], values, 3)
    fit = quasi_ml(DRIVE, series, DRIVE.theta())
    gain = {
        name: fit_tails(fit, make_effect(name, Setting(DRIVE)), series)[0]
        for name in ("heavy-tails:reading", "heavy-tails:speed")
    }
    assert gain["heavy-tails:speed"] > gain["heavy-tails:reading"] + 4.0


def test_missing_values_are_passed_over():
    series = hidden([], {}, 4)
    y = series.y.copy()
    y[100:140] = np.nan
    gap = engine.Series(y, series.u, t=series.t)
    terms = outlier_log_terms(DRIVE, THETA, gap, "reading", np.array([0.1]), np.array([5.0]))
    assert np.isfinite(terms).all()
    np.testing.assert_allclose(terms[100:140], 0.0, atol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("share_of_noise", [0.5, 1e-4])
def test_outliers_gain_what_they_do_with_noise_of_the_right_size(share_of_noise):
    """They make the noise seem large, or that of the process where the sensor's is next to nothing."""
    level = engine.get_model("local-level")
    values = {"level": 1000.0, "q": 1500.0, "r": 15000.0 * share_of_noise}
    true = level.theta({k: v for k, v in values.items() if k in level.parameter_names})
    rng = np.random.default_rng(5)
    y = engine.simulate(level, true, 300, rng).series.y.copy()
    hit = rng.choice(300, 12, replace=False)
    y[hit, 0] += 800.0 * rng.standard_normal(12)
    series = engine.Series(y, dt=1.0)
    # not from so small an r, which is the first state's variance, too: it ends where both vanish
    fit = quasi_ml(level, series, {"q": 1500.0, "level": 1000.0})
    setting = Setting(level)
    output = next(iter(level.outputs))
    gain, theta = fit_tails(fit, make_effect(f"heavy-tails:{output}", setting), series)
    ratio = max(800.0 / np.sqrt(true["r"]), 1.0)
    shares, ratios = np.array([0.04]), np.array([ratio])
    known = outlier_log_terms(level, np.asarray(true), series, output, shares, ratios).sum()
    assert gain >= 0.9 * 2.0 * (known - fit.log_likelihood)
    assert gain > 60.0
    state = next(iter({**level.nonlinear, **level.linear}))
    other, _ = fit_tails(fit, make_effect(f"heavy-tails:{state}", setting), series)
    assert gain > other + 10.0
    own = theta[: len(fit.theta)]
    at_own = outlier_log_terms(level, own, series, output, theta[-2:-1], theta[-1:]).sum()
    assert 2.0 * (at_own - fit.log_likelihood) == pytest.approx(gain, abs=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_size_gain_and_errors_are_those_of_the_exact_mixture(seed):
    """Of a model without process noise, whose likelihood with outliers is a sum: nothing is left undone."""
    series, model = record(seed), decay(False)
    found = engine.diagnose(model, series, effects=["heavy-tails", "bias", "drift"], held_out=0)
    (cause,) = found.causes
    assert cause.effect == "heavy-tails:y"
    values = np.asarray(found.after.theta)
    share, ratio = cause.parameters.values()
    assert values[-2:].tolist() == [share, ratio]
    assert mixture(values, series) > most_likely(series) - 0.5
    plain = quasi_ml(model, series)
    gained = 2.0 * (most_likely(series) - plain.log_likelihood)
    assert cause.gain == pytest.approx(gained, abs=0.5)
    assert abs(share - 7 / 60) < 3.0 * cause.standard_error < 3.0 * 0.12


def constant(ny=1):
    """A constant, known to be zero, read with unit noise: every reading is independent of the others."""
    return engine.MixedModel(
        name="constant",
        linear={"x": "1"},
        outputs={f"y{i}": "1" for i in range(ny)},
        parameters=[engine.Parameter("r", 1.0, "1", (1e-3, 1e3))],
        dynamics=lambda a, u, t, dt, theta: (np.zeros((len(a), 1)), [[1.0]], [[0.0]]),
        measurement=lambda a, u, t, theta: (
            np.zeros((len(a), ny)),
            np.ones((ny, 1)),
            theta.r**2 * np.eye(ny),
        ),
        initial=lambda theta: (engine.Gaussian([], np.zeros((0, 0))), [0.0], [[0.0]]),
    )


@pytest.mark.parametrize("nu", [1.0, 3.0, 30.0])
def test_student_t_is_its_density(nu):
    """Within 4 % at usual readings, within a quarter of a nat at those up to 15 scales away."""
    y = np.concatenate([np.linspace(-4.0, 4.0, 33), [-15.0, -8.0, 8.0, 15.0]])
    model, series = with_student_t(constant(), nu_default=nu), engine.Series(y, dt=1.0)
    terms = moment_filter(model, np.asarray(model.theta())[None], series).log_terms[:, 0]
    exact = student_t.logpdf(y, nu)
    usual = np.abs(y) <= 4.0
    np.testing.assert_allclose(terms[usual], exact[usual], atol=0.04)
    if nu < 10.0:
        np.testing.assert_allclose(terms, exact, atol=0.25)


def test_the_score_of_a_shift_is_that_of_the_mixture():
    """S of the path is the one by which the slope of the log-density, -r / S, comes out."""
    y = np.array([0.3, -1.2, 6.0, 2.5])
    model = with_mixture(constant(), share_default=0.1, ratio_default=5.0)
    theta, h = np.asarray(model.theta()), 1e-5
    path = moment_path(model, theta, engine.Series(y, dt=1.0))

    def log_density(y):
        return moment_filter(model, theta[None], engine.Series(y, dt=1.0)).log_terms[:, 0]

    slope = (log_density(y + h) - log_density(y - h)) / (2.0 * h)
    np.testing.assert_allclose(-path.innovations[:, 0] / path.S[:, 0, 0], slope, rtol=1e-6)
    assert path.log_likelihood == pytest.approx(log_density(y).sum())
    predicted = 0.9 + 0.1 * 5.0**2  # the variance of the mixture, whatever came
    np.testing.assert_allclose(path.S_predicted[:, 0, 0], predicted)


@pytest.mark.long
def test_outliers_of_two_kinds_are_told_by_all_their_combinations():
    one = with_mixture(constant(2), channels=["y0"], share_default=0.2, ratio_default=4.0, name="a")
    both = with_mixture(one, channels=["y1"], share_default=0.1, ratio_default=8.0, name="b")
    y = np.random.default_rng(1).normal(0.0, 2.0, (20, 2))
    found = moment_filter(both, np.asarray(both.theta())[None], engine.Series(y, dt=1.0))
    alone = [
        np.log((1.0 - share) * norm.pdf(v) + share * norm.pdf(v, scale=ratio))
        for v, share, ratio in zip(y.T, (0.2, 0.1), (4.0, 8.0), strict=True)
    ]
    np.testing.assert_allclose(found.log_terms[:, 0], sum(alone), rtol=1e-12)


@pytest.mark.parametrize("where", ["measurement", "dynamics"])
@pytest.mark.parametrize("length", [17, 10**9])
def test_linear_models_are_filtered_for_many_rows_at_once(where, length, monkeypatch):
    """As step by step: with rows missing, records together, irregular times, and thetas beside each other."""
    level = engine.get_model("local-level")
    model = with_mixture(level, where, share_default=0.1, ratio_default=6.0)
    rng, each = np.random.default_rng(3), []
    for n in (40, 30):
        t = np.cumsum(rng.uniform(0.5, 1.5, n))
        y = engine.simulate(model, None, n, rng, t=t).series.y.copy()
        y[5:9] = np.nan
        each.append(engine.Series(y, t=t))
    thetas = np.repeat(np.asarray(model.theta())[None], 3, axis=0)
    thetas[1] *= 1.1
    thetas[2, -1] = 3.0
    monkeypatch.setattr(strata, "NUMBERS", length)
    for series in (each[0], together(each)):
        whole = moment_filter(model, thetas, series)
        with monkeypatch.context() as other:
            other.setattr(strata, "_all_at_once", strata._step_by_step)
            by_step = moment_filter(model, thetas, series)
        for name in ("innovations", "S", "log_terms"):
            np.testing.assert_allclose(
                getattr(whole, name), getattr(by_step, name), rtol=1e-9, atol=1e-9
            )
