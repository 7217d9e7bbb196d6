"""A noise that a search has left at nothing is found where it is large."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import engine
from engine.estimation.e_steps import rbps_step
from engine.estimation.edges import in_turn
from engine.estimation.likelihood_step import LikelihoodStep
from engine.estimation.quasi_ml import quasi_ml
from engine.estimation.start import WarmStart
from engine.estimation.vanished import _flat, revived, revived_by_particles, without_it
from engine.statespace.model import Theta

SERVO = engine.get_model("servo")
NOISE = ("sigma_v", "sigma_load", "sigma_y")
DT = 0.04  # s


@cache
def drive(seed, friction, offset):
    """A drive with friction, simulated, and the best free run of one without any."""
    rng = np.random.default_rng(seed)
    u = np.repeat(1.5 * rng.normal(size=30), 20)[:, None]
    theta = {"M": 95.0, "Fv": 203.0, "Fc": friction, "offset": offset}
    noise = {"sigma_v": 2e-3, "sigma_load": 1e-3, "sigma_y": 1e-4}
    series = engine.simulate(SERVO, theta | noise, len(u), rng, u=u, dt=DT).series
    start = {"Fc": 0.0, "offset": 0.0}
    fit = engine.fit_simulation(SERVO, series, start, ["M", "Fv"], n_starts=4)
    return series, fit.theta


@pytest.mark.long
@pytest.mark.parametrize("friction", [10.0, 12.0])
def test_noise_of_a_wrong_model_is_not_left_at_nothing(friction):
    series, theta = drive(4, friction, -3.0)
    stuck = quasi_ml(SERVO, series, theta, NOISE)
    assert stuck.converged
    assert stuck.theta["sigma_load"] == 0.0  # a local maximum: no slope leads away
    found = revived(stuck, [series])
    assert found.log_likelihood > stuck.log_likelihood + 50.0
    assert found.theta["sigma_load"] > 10.0
    high = quasi_ml(SERVO, series, {**theta.asdict(), "sigma_load": 200.0}, NOISE)
    assert found.log_likelihood == pytest.approx(high.log_likelihood, abs=0.1)


WRITTEN = {  # as what a parameter gives the standard deviation, and the other way round, from where it is gone
    "logarithm": (np.exp, np.log, -20.0),
    "logarithm that drifts": (np.exp, np.log, -8.0),
    "logarithm of the variance": (lambda x: np.exp(x / 2.0), lambda s: 2.0 * np.log(s), -40.0),
    "precision": (lambda x: x**-0.5, lambda s: s**-2.0, 1e10),
}


def written(how):
    """The drive's model with its load noise written otherwise, and where that has vanished."""
    spread, inverse, gone = WRITTEN[how]
    lower = 0.0 if how == "precision" else -np.inf

    def read(theta):
        return theta._replace(sigma_load=spread(theta.sigma_load))

    parameters = [
        replace(p, default=float(inverse(p.default)), bounds=(lower, np.inf))
        if p.name == "sigma_load"
        else p
        for p in SERVO.parameters
    ]
    model = replace(
        SERVO,
        dynamics=lambda a, u, t, dt, theta: SERVO.dynamics(a, u, t, dt, read(theta)),
        measurement=lambda a, u, t, theta: SERVO.measurement(a, u, t, read(theta)),
        initial=lambda theta: SERVO.initial(read(theta)),
        parameters=parameters,
    )
    return model, gone


@pytest.mark.long
@pytest.mark.parametrize("how", WRITTEN)
def test_however_it_is_written(how):
    series, theta = drive(4, 10.0, -3.0)
    high = quasi_ml(SERVO, series, {**theta.asdict(), "sigma_load": 200.0}, NOISE)
    model, gone = written(how)
    stuck = quasi_ml(model, series, {**theta.asdict(), "sigma_load": gone}, NOISE)
    assert stuck.log_likelihood < high.log_likelihood - 100.0
    found = revived(stuck, [series])
    assert found.log_likelihood == pytest.approx(high.log_likelihood, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["logarithm of the variance", "precision"])
def test_an_estimation_without_a_search_for_a_start_ends_at_it_where_the_model_is_linear(how):
    series, theta = drive(4, 10.0, -3.0)
    high = quasi_ml(SERVO, series, {**theta.asdict(), "sigma_load": 200.0}, NOISE)
    model, gone = written(how)
    start = {**theta.asdict(), "sigma_load": gone}
    found = engine.rbps_em(model, series, start, NOISE, warm_start=False, seed=1)
    value = LikelihoodStep(model, [series]).of(found.theta)
    assert value == pytest.approx(high.log_likelihood, abs=1.0)


@pytest.mark.long
def test_a_start_of_an_estimation_has_it_too():
    series, theta = drive(4, 10.0, -3.0)
    high = quasi_ml(SERVO, series, {**theta.asdict(), "sigma_load": 200.0}, NOISE)
    search = WarmStart(SERVO, [series], SERVO.free_indices(NOISE))
    search(theta)
    assert search.apart[0].log_likelihood == pytest.approx(high.log_likelihood, abs=0.1)


@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_noise_that_is_not_there_stays_at_nothing(unit):
    """A constant, read with noise: its walk has nothing to do, in any unit."""
    model = engine.get_model("local-level")
    rng = np.random.default_rng(5)
    series = engine.Series(unit * (100.0 + rng.standard_normal(200)), dt=1.0)
    fit = quasi_ml(model, series, {"q": unit**2, "r": unit**2, "level": 100.0 * unit})
    assert fit.theta["q"] < 0.01 * fit.theta["r"]
    assert revived(fit, [series]) is fit


def _dynamics(a, u, t, dt, theta):
    f, A = [1.0 + 0.95 * (a[:, 0] - 1.0), 0.0], [[0.0], [theta.phi]]
    return f, A, np.diag([theta.s**2, theta.q**2])


# a signal z whose gain a wanders: y = a z + e, where the moment filter takes all noise for the gain's
GAIN = engine.MixedModel(
    name="gain",
    dynamics=_dynamics,
    measurement=lambda a, u, t, theta: ([0.0], a[:, :1, None], [[theta.r**2]]),
    initial=lambda theta: (engine.Gaussian([1.0], [[0.1]]), [0.0], [[1.0]]),
    nonlinear={"a": "1"},
    linear={"z": "1"},
    outputs={"y": "1"},
    parameters=[
        engine.Parameter("s", 0.2, "1", (0.0, 3.0)),
        engine.Parameter("phi", 0.9, "1", (-1.0, 1.0)),
        engine.Parameter("q", 0.5, "1", (0.0, 5.0)),
        engine.Parameter("r", 0.1, "1", (1e-3, 5.0)),
    ],
)
STUCK = {"s": 0.14, "phi": 0.84, "q": 0.63, "r": 2e-3}


def gained(seed, r):
    return engine.simulate(GAIN, {"r": r}, 200, np.random.default_rng(seed), dt=1.0).series


def by_particles(series, theta, start):
    indices = GAIN.free_indices(None)
    particles = rbps_step(GAIN, [series], 50, 50)
    return revived_by_particles(GAIN, GAIN.theta(theta), indices, particles, start)


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_particles_find_noise_that_the_moment_filter_took_away(seed):
    series = gained(5, 0.2)
    found = by_particles(series, STUCK, seed)
    assert 0.03 < found["r"] < 0.3
    likelihood = LikelihoodStep(GAIN, [series])
    assert likelihood.of(GAIN.theta(STUCK)) > likelihood.of(found)


@pytest.mark.long
def test_particles_find_its_logarithm():
    model = replace(
        GAIN,
        measurement=lambda a, u, t, theta: ([0.0], a[:, :1, None], [[np.exp(2.0 * theta.r)]]),
        parameters=[*GAIN.parameters[:3], engine.Parameter("r", np.log(0.1), "", (-20.0, 5.0))],
    )
    series, theta = gained(5, 0.2), model.theta({**STUCK, "r": np.log(STUCK["r"])})
    particles = rbps_step(model, [series], 50, 50, moment=LikelihoodStep(model, [series]).of)
    found = revived_by_particles(model, theta, model.free_indices(None), particles, 0)
    assert 0.03 < np.exp(found["r"]) < 0.4


@pytest.mark.long
def test_particles_leave_noise_that_is_not_there():
    assert by_particles(gained(5, 1e-3), STUCK, 1) is None


@pytest.mark.parametrize("fails", [False, True])
def test_sides_are_asked_in_one_pass_as_one_after_the_other(fails):
    def dynamics(a, u, t, dt, theta):
        if fails and theta.q > 4.5:
            raise KeyError("so large a noise")
        return GAIN.dynamics(a, u, t, dt, theta)

    model = replace(GAIN, dynamics=dynamics)
    series, theta = gained(5, 0.2), model.theta(STUCK)
    likelihood = LikelihoodStep(model, [series])
    particles = rbps_step(model, [series], 50, 50, moment=likelihood.of)
    sides = [(k, up) for k in range(4) for up in (False, True)]
    alone = [side for side in sides if _flat(model, theta, [side], particles)]
    assert _flat(model, theta, sides, particles) == alone
    values = [without_it(model, theta, *side)[None] for side in sides]
    ways = [in_turn(theta, np.array([k]), v) for (k, _), v in zip(sides, values, strict=True)]
    thetas = np.concatenate(ways)
    each = [likelihood.of(Theta(x, theta.names)) for x in thetas]
    assert np.isnan(each).any() == fails
    np.testing.assert_allclose(likelihood.of_each(thetas), each, rtol=1e-9)


def test_particles_look_at_nothing_that_has_not_vanished():
    assert by_particles(gained(5, 1e-3), {"r": 0.1}, 1) is None


@pytest.mark.slow
@pytest.mark.parametrize("r", [1e-3, 2e-3])
def test_errors_are_not_told_as_those_of_an_estimate_there(r):
    with pytest.warns(engine.NotSettledWarning, match=r"away from the bound of r \(to some 0\.1"):
        found = engine.standard_errors(GAIN, {**STUCK, "r": r}, gained(5, 0.2), n_particles=50)
    assert not found.settled


@pytest.mark.slow
def test_nor_are_intervals():
    with pytest.warns(
        engine.NotSettledWarning, match=r"no intervals of .* the bound of r \(to some 0\.1"
    ):
        found = engine.likelihood_intervals(
            GAIN, {**STUCK, "r": 1e-3}, gained(5, 0.2), free=["r", "phi"], n_particles=50
        )
    assert "no intervals of an estimate" in found.warning


@pytest.mark.slow
def test_an_estimation_does_not_end_where_the_moment_filter_took_noise_away():
    series = gained(5, 0.2)
    found = engine.rbps_em(GAIN, series, STUCK, n_particles=50, seed=1, warm_start=False)
    assert found.theta["r"] > 0.1


def by_logarithm(a, u, t, dt, theta):
    """A walk whose author knows that it walks, and by no more than a few metres."""
    if theta.q > 10.0:
        raise ValueError("too far")
    return [0.0], [[1.0]], [[math.exp(2.0 * math.log(theta.q))]]


def test_a_model_that_cannot_be_had_without_noise_or_with_much_of_it_is_left_alone():
    """A user's function may fail at a bound, and far beyond what its author thought of."""
    model = engine.MixedModel(
        name="walk",
        dynamics=by_logarithm,
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r**2]]),
        initial=lambda theta: (engine.Gaussian([], np.zeros((0, 0))), [0.0], [[1.0]]),
        linear={"place": "m"},
        outputs={"y": "m"},
        parameters=[
            engine.Parameter("q", 0.1, "m", (0.0, 100.0)),
            engine.Parameter("r", 1.0, "m", (0.0, 100.0)),
        ],
    )
    rng = np.random.default_rng(0)
    way, read = np.cumsum(rng.standard_normal(200)), rng.standard_normal(200)
    still = engine.Series(0.02 * way + read, dt=1.0)
    fit = replace(quasi_ml(model, still, {"q": 0.02}, ["r"]), free=("q", "r"))
    assert revived(fit, [still]) is fit
    walking = engine.Series(way + read, dt=1.0)
    search = WarmStart(model, [walking], model.free_indices(None))
    search(model.theta({"q": 0.5}))
    assert not search.note
