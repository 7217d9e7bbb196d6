"""Student-t and mixture noise by scale mixtures, against numerical integration on a linear model."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import gamma, kstest, norm
from scipy.stats import t as student

import engine
from engine.diagnose import extend as extend_by
from engine.diagnose.effects.setting import Setting
from engine.errors import OptionError
from engine.filters.heavy_tails import with_mixture, with_student_t
from engine.filters.sigma_point import moment_filter
from engine.statespace.checks import check_model
from engine.statespace.shapes import stacked
from tests.engine.hidden_effects import DRIVE
from tests.engine.plain_models import room

LEVEL = engine.get_model("local-level")
THETA = {"q": 0.1, "r": 0.2, "level": 0.0}
MIXED = engine.get_model("mixed-4")

Noise = Callable[[np.ndarray], np.ndarray]


PAIR = engine.MixedModel(
    name="pair",
    linear={"x": "1"},
    outputs={"y0": "1", "y1": "1"},
    parameters=[],
    dynamics=lambda a, u, t, dt, theta: (np.zeros((len(a), 1)), [[0.9]], [[0.1]]),
    measurement=lambda a, u, t, theta: (np.zeros((len(a), 2)), np.ones((2, 1)), np.eye(2)),
    initial=lambda theta: (engine.Gaussian([], np.zeros((0, 0))), [0.0], [[1.0]]),
)


def scale(model: engine.MixedModel, g: np.ndarray, values: dict[str, float]) -> np.ndarray:
    """Of the noise of the one reading (M,) where the last nonlinear state is g (M,)."""
    theta = model.theta({**values, "r": 1.0})
    a = np.zeros((len(g), model.na))
    a[:, -1] = g
    return model.observation(a, np.empty(0), 0.0, model.record(theta))[2][:, 0, 0]


def student_scale(g: np.ndarray, nu: float) -> np.ndarray:
    """1 / s is Gamma(nu / 2, rate nu / 2), and g a standard Gaussian."""
    return 0.5 * nu / gamma.isf(norm.cdf(g), 0.5 * nu)


def t_noise(variance: float, nu: float) -> Noise:
    return lambda e: student.pdf(e / np.sqrt(variance), nu) / np.sqrt(variance)


def mixture_noise(variance: float, share: float, ratio: float) -> Noise:
    sd = np.sqrt(variance)
    return lambda e: (1 - share) * norm.pdf(e, 0, sd) + share * norm.pdf(e, 0, ratio * sd)


def gaussian_noise(variance: float) -> Noise:
    return lambda e: norm.pdf(e, 0, np.sqrt(variance))


def integrated(y: np.ndarray, step: Noise, measurement: Noise) -> float:
    """log p(y) of the local-level model with any noise, by numerical integration over a grid."""
    z = np.linspace(y.min() - 6.0, y.max() + 6.0, 801)
    width = z[1] - z[0]
    kernel = step(width * np.arange(1.0 - z.size, z.size))
    p = norm.pdf(z, 0.0, np.sqrt(THETA["r"]))
    log_likelihood = 0.0
    for t, value in enumerate(y):
        if t:
            p = np.convolve(kernel, p, "valid") * width
        p = p * measurement(value - z)
        total = p.sum() * width
        log_likelihood += np.log(total)
        p /= total
    return float(log_likelihood)


def contaminated(T: int, seed: int) -> np.ndarray:
    """A local level with Student-t measurement noise of 2.5 degrees of freedom."""
    rng = np.random.default_rng(seed)
    z = np.cumsum(np.sqrt(0.1) * rng.standard_normal(T))
    return z + np.sqrt(0.2) * rng.standard_t(2.5, T)


def test_the_scale_makes_the_noise_it_should() -> None:
    rng = np.random.default_rng(0)
    g, e = rng.standard_normal(40_000), rng.standard_normal(40_000)
    for nu in (0.7, 3.0, 50.0):
        s = scale(with_student_t(LEVEL), g, {"nu": nu})
        assert kstest(e * np.sqrt(s), student(nu).cdf).pvalue > 1e-3
    mixed = with_mixture(LEVEL)
    mean = mixed.random_scales[0].mean((0.1, 7.0))
    s = scale(mixed, g + mean, {"outlier_share": 0.1, "outlier_ratio": 7.0}).round(9)
    np.testing.assert_allclose(np.unique(s), [1.0, 49.0])
    assert abs((s > 1.0).mean() - 0.1) < 0.006


CASES = {
    "t in e": (with_student_t(LEVEL), {"nu": 3.0}, gaussian_noise(0.1), t_noise(0.2, 3.0)),
    "mixture in e": (
        with_mixture(LEVEL),
        {"outlier_share": 0.1, "outlier_ratio": 6.0},
        gaussian_noise(0.1),
        mixture_noise(0.2, 0.1, 6.0),
    ),
    "t in w": (
        with_student_t(LEVEL, "dynamics"),
        {"nu": 3.0},
        t_noise(0.1, 3.0),
        gaussian_noise(0.2),
    ),
    "both": (
        with_student_t(with_mixture(LEVEL, "dynamics")),
        {"outlier_share": 0.1, "outlier_ratio": 6.0, "nu": 3.0},
        mixture_noise(0.1, 0.1, 6.0),
        t_noise(0.2, 3.0),
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_likelihood_agrees_with_numerical_integration(case: str) -> None:
    model, extra, step, measurement = CASES[case]
    check_model(model)
    y = contaminated(25, 3)
    exact = integrated(y, step, measurement)
    found = [
        engine.rbpf(
            model, THETA | extra, engine.Series(y), 1000, np.random.default_rng(k)
        ).log_likelihood
        for k in range(16)
    ]
    ratio = np.exp(np.array(found) - exact)  # its expectation is 1
    assert abs(ratio.mean() - 1.0) < 4.0 * ratio.std() / 4.0 + 0.002
    assert ratio.std() < 0.25


@pytest.mark.slow
def test_nu_is_estimated() -> None:
    """EM ends where the numerically integrated likelihood is largest."""
    y = contaminated(150, 5)
    best = minimize_scalar(
        lambda log_nu: -integrated(y, gaussian_noise(0.1), t_noise(0.2, np.exp(log_nu))),
        bounds=(-0.5, 4.0),
        method="bounded",
        options={"xatol": 0.02},
    )
    run = engine.rbps_em(
        with_student_t(LEVEL),
        engine.Series(y),
        THETA | {"nu": 8.0},
        ["nu"],
        n_particles=40,
        n_iterations=15,
        tolerance=None,
        warm_start=False,
    )
    assert run.theta["nu"] == pytest.approx(np.exp(best.x), rel=0.15)


@pytest.mark.slow
def test_share_and_size_of_outliers_are_estimated() -> None:
    rng = np.random.default_rng(8)
    T = 200
    bad = rng.random(T) < 0.08
    z = np.cumsum(np.sqrt(0.1) * rng.standard_normal(T))
    y = z + np.sqrt(0.2) * np.where(bad, 10.0, 1.0) * rng.standard_normal(T)
    run = engine.rbps_em(
        with_mixture(LEVEL),
        engine.Series(y),
        THETA | {"outlier_share": 0.3, "outlier_ratio": 4.0},
        ["outlier_share", "outlier_ratio"],
        n_particles=40,
        n_iterations=25,
        tolerance=None,
        warm_start=False,
    )
    assert run.theta["outlier_share"] == pytest.approx(bad.mean(), rel=0.4)
    assert run.theta["outlier_ratio"] == pytest.approx(10.0, rel=0.35)


@pytest.fixture(scope="module")
def spoilt() -> tuple[engine.Simulation, engine.Series, np.ndarray]:
    """mixed-4 with 2 % of the rows off by ten standard deviations."""
    rng = np.random.default_rng(4)
    clean = engine.simulate(MIXED, None, 200, rng)
    rows = np.sort(rng.choice(np.arange(5, 195), 4, replace=False))
    y = clean.y.copy()
    y[rows] += 10.0 * np.sqrt(0.1) * rng.choice([-1.0, 1.0], (4, 2))
    return clean, engine.Series(y), rows


@pytest.mark.long
@pytest.mark.parametrize("extend", [with_student_t, with_mixture])
def test_default_filter_survives_outliers(
    extend: Callable[[engine.MixedModel], engine.MixedModel],
    spoilt: tuple[engine.Simulation, engine.Series, np.ndarray],
) -> None:
    """M = 100: the effective sample size at outliers stays healthy, the blind proposal's does not."""
    _, series, rows = spoilt
    runs = {
        proposal: [
            engine.rbpf(extend(MIXED), None, series, 100, np.random.default_rng(k), proposal)
            for k in range(5)
        ]
        for proposal in ("adapted", "bootstrap")
    }
    assert all(len(run.collapsed) == 0 for run in runs["adapted"])
    assert min(run.ess[rows].min() for run in runs["adapted"]) > 20.0
    assert np.mean([run.ess[rows].mean() for run in runs["bootstrap"]]) < 10.0
    plain = engine.rbpf(MIXED, None, series, 500, np.random.default_rng(0))
    assert runs["adapted"][0].log_likelihood > plain.log_likelihood + 50.0


@pytest.mark.long
def test_outliers_are_given_little_weight(
    spoilt: tuple[engine.Simulation, engine.Series, np.ndarray],
) -> None:
    clean, series, rows = spoilt
    rng = np.random.default_rng(1)
    robust, error = with_student_t(MIXED), []
    for model in (MIXED, robust):
        draws = engine.rb_ffbsi(engine.rbpf(model, None, series, 200, rng), 100, rng, joint=True)
        smoothed = engine.condition_on_trajectories(draws)
        z = smoothed.mean()[:, model.na :]
        error.append(np.sqrt(((z - clean.z) ** 2).mean(axis=0)))
    gauss, student = error
    assert (student < gauss).all()
    assert student.sum() < 0.85 * gauss.sum()
    g = smoothed.a[:, :, 1]
    s = student_scale(g, 4.0).mean(axis=1)
    assert set(np.argsort(s)[-4:]) == set(rows)  # the estimated scale points at the outliers


def test_only_the_named_channels_are_scaled() -> None:
    model = with_student_t(MIXED, channels=["y2"])
    a = np.array([[0.3, 0.0], [0.3, 3.0]])
    _, _, R = model.observation(a, np.empty(0), 0.0, model.record(model.theta()))
    assert R[0, 0, 0] == R[1, 0, 0] == pytest.approx(0.1)
    assert R[1, 1, 1] > 10.0 * R[0, 1, 1]
    model = with_student_t(MIXED, "dynamics", channels=["z2"])
    _, _, Q = model.transition(a, np.empty(0), 0.0, 1.0, model.record(model.theta()))
    np.testing.assert_allclose(np.diag(Q[1])[[0, 1, 2, 4]], [0.01, 1.0, 0.01, 0.01])
    assert Q[1, 3, 3] > 0.1


def test_a_start_that_is_not_gaussian_keeps_its_density() -> None:
    from dataclasses import replace

    class Uniform:
        def sample(self, rng: np.random.Generator, n: int) -> np.ndarray:
            return rng.random((n, 1))

        def log_density(self, a: np.ndarray) -> np.ndarray:
            return np.where((a[:, 0] >= 0) & (a[:, 0] <= 1), 0.0, -np.inf)

    base = replace(MIXED, initial=lambda theta: (Uniform(), np.zeros(3), np.zeros((3, 3))))
    model = with_mixture(base)
    density = model.start(model.record(model.theta())).density
    a = density.sample(np.random.default_rng(0), 1000)
    assert a.shape == (1000, 2)
    np.testing.assert_allclose(density.log_density(a), norm.logpdf(a[:, 1], norm.ppf(0.02)))


def test_what_cannot_be_is_named() -> None:
    with pytest.raises(OptionError, match="where"):
        with_student_t(MIXED, "everywhere")
    with pytest.raises(OptionError, match="y3"):
        with_student_t(MIXED, channels=["y3"])
    with pytest.raises(OptionError, match="name="):
        with_student_t(with_student_t(MIXED), "dynamics")


@pytest.mark.long
@pytest.mark.parametrize("extend", [engine.with_mixture, engine.with_student_t])
@pytest.mark.parametrize(
    "effects",
    [
        ["bias:reading"],
        *(pytest.param([one], marks=pytest.mark.slow) for one in ("pole:speed", "drag:speed")),
    ],
)
def test_an_effect_leaves_the_proposal_of_outliers_as_it_is(extend, effects):
    """Added to a model that has them it changes nothing at size zero, the particles' likelihood included."""
    model = extend(DRIVE)
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(-2.0, 2.0, 10), 20)
    series = engine.simulate(model, None, 200, rng, u=u, dt=0.1).series
    y = series.y.copy()
    y[::25] += 1.0
    series = series.replace(y=y)

    def value(which):
        runs = [
            engine.rbpf(which, None, series, 100, np.random.default_rng(k)).log_likelihood
            for k in range(6)
        ]
        return np.mean(runs), np.std(runs)

    plain, spread = value(model)
    extended, own = value(extend_by(model, effects, Setting(model)))
    assert extended == pytest.approx(plain, abs=1.0 + 2.0 * spread)
    assert own < 2.0 * spread + 0.5


@pytest.mark.long
def test_outliers_of_two_readings_are_drawn_together():
    one = engine.with_mixture(PAIR, channels=["y0"], share_default=0.1, name="a")
    both = engine.with_mixture(one, channels=["y1"], share_default=0.1, name="b")
    series = engine.simulate(both, None, 100, np.random.default_rng(0)).series
    exact = moment_filter(both, np.asarray(both.theta())[None], series).log_likelihood[0]
    runs = [
        engine.rbpf(both, None, series, 100, np.random.default_rng(k)).log_likelihood
        for k in range(4)
    ]
    assert np.mean(runs) == pytest.approx(exact, abs=2.0)


@pytest.mark.parametrize("extend", [with_mixture, with_student_t])
def test_a_model_that_knows_outliers_is_pickled(extend):
    model = extend(LEVEL, name="one")
    back = pickle.loads(pickle.dumps(extend(model, "dynamics", name="two")))
    series = engine.Series(np.arange(20.0) ** 2, dt=1.0)
    theta = np.asarray(back.theta())[None]
    known = moment_filter(extend(model, "dynamics", name="two"), theta, series)
    np.testing.assert_array_equal(moment_filter(back, theta, series).log_terms, known.log_terms)
    runs = [
        engine.rbpf(one, None, series, 20, np.random.default_rng(1)).log_likelihood
        for one in (back, extend(model, "dynamics", name="two"))
    ]
    assert runs[0] == runs[1]


@pytest.mark.parametrize("where", ["measurement", "dynamics"])
@pytest.mark.parametrize("maker", [with_mixture, with_student_t])
def test_rows_of_states_times_and_parameters_are_those_one_by_one(maker, where):
    """They hand their rows on untried, so that this is all that looks at what they do with them."""
    model, M = maker(room(continuous=True), where=where), 6
    rng = np.random.default_rng(4)
    a = np.column_stack([rng.normal(20.0, 1.0, M), rng.normal(0.0, 3.0, M)])
    u, t, dt = rng.uniform(0.5, 2.0, (2, M)), rng.uniform(0.0, 9.0, M), rng.uniform(0.1, 0.5, M)
    many = np.asarray(model.theta()) * rng.uniform(0.8, 1.2, (M, len(model.parameters)))
    for thetas in (many, np.repeat(many[:1], M, axis=0)):
        record = model.records(thetas)
        together = model.transition(a, u, t, dt, record), model.observation(a, u, t, record)
        for i in range(M):
            row, own = (a[i : i + 1], u[:, i], float(t[i])), model.record(thetas[i])
            alone = model.transition(*row, float(dt[i]), own), model.observation(*row, own)
            for rows, one in zip(together, alone, strict=True):
                np.testing.assert_allclose(rows[0][i], one[0][0], rtol=1e-6)  # by a table of scales
                for matrix, single in zip(rows[1:], one[1:], strict=True):
                    each = np.broadcast_to(stacked(matrix), (M, *matrix.shape[-2:]))
                    np.testing.assert_allclose(each[i], stacked(single)[0], rtol=1e-6)
