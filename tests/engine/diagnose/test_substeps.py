"""Several steps of the model from sample to sample: physics within the step, memories by the sample."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import COUNTING, all_effects, extend, make_effect
from engine.diagnose.effects.effect import carried
from engine.diagnose.effects.hide import hide
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.rates import guessed_points
from engine.diagnose.effects.setting import Setting
from engine.diagnose.records import Records
from engine.diagnose.screening.time_scan import grid
from engine.diagnose.steps import substeps
from engine.diagnose.steps.substeps import (
    are_too_long,
    is_consistent,
    is_enough,
    prepare,
    steps_for,
)
from engine.errors import OptionError, SeriesError
from engine.estimation.quasi_ml import quasi_ml
from engine.filters.sigma_point import moment_filter
from tests.engine.plain_models import heated, pendulum


def swings(n=120, dt=0.08, seed=3):
    """A series of the shipped oscillator, which is discretised exactly."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, -(-n // 10)), 10)[:n]
    return engine.simulate(engine.get_model("oscillator"), None, n, rng, u=u, dt=dt).series


def by_runge_kutta(n, dt, drag=0.0, seed=1):
    """The pendulum's equation in steps of dt / 20, as another program would integrate it."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.5, 1.5, n // 10), 10)
    x, y, h = np.array([0.2, 0.0]), [], dt / 20.0

    def rate(x, u):
        force = -9.0 * np.sin(x[0]) - 0.3 * x[1] - drag * x[1] * abs(x[1]) + 4.0 * u
        return np.array([x[1], force])

    for one in u:
        y.append(x[0] + 0.005 * rng.standard_normal())
        for _ in range(20):
            k1 = rate(x, one)
            k2 = rate(x + 0.5 * h * k1, one)
            k3 = rate(x + 0.5 * h * k2, one)
            k4 = rate(x + h * k3, one)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            x[1] += np.sqrt(h) * 0.05 * rng.standard_normal()
    return engine.Series(np.array(y), u, dt=dt)


def with_noise(model, euler=False):
    """The pendulum with its noise to be estimated, by Euler's method where asked for."""

    def dynamics(a, u, t, dt, th):
        q, v = a.T
        if euler:
            force = -th.stiffness * np.sin(q) - th.damping * v + th.torque * u[0]
            f = np.stack([q + dt * v, v + dt * force], axis=1)
        else:
            f = model.dynamics(a, u, t, dt, th)[0]
        return f, np.zeros((2, 0)), [[dt * th.sq**2, 0.0], [0.0, dt * th.sv**2]]

    noises = [
        engine.Parameter(name, value, "1", (1e-6, 10.0))
        for name, value in (("sq", 1e-2), ("sv", 0.1), ("sy", 0.02))
    ]
    return replace(
        model,
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[th.sy**2]]),
        parameters=[*model.parameters, *noises],
    )


def gained(fit, series, name, starts, setting=None):
    """Log-likelihood that an effect gains over a fit, and the extended model's fit."""
    model = fit.model
    theta = np.asarray(fit.theta)
    effect = make_effect(name, setting or setting_for(model, series, theta))
    extended = effect.apply(model)
    free = [*fit.free, *(p.name for p in effect.parameters if p.name not in effect.held)]
    fits = []
    for own in starts:
        start = np.clip(extended.theta(), extended.lower, extended.upper)
        start[: len(theta)] = theta
        for key, value in own.items():
            start[extended.index(key)] = value
        fits.append(quasi_ml(extended, series, start, free))
    best = max(fits, key=lambda one: one.log_likelihood)
    return best.log_likelihood - fit.log_likelihood, best


def test_a_refined_series_is_the_same_experiment():
    t = np.array([0.0, 1.0, 1.5, 3.5])
    y = np.array([[1.0], [np.nan], [3.0], [4.0]])
    series = engine.Series(y, [1.0, 2.0, 3.0, 4.0], t=t, extra=t, extra_names=["t"])
    fine = series.refined(3)
    assert (len(fine), fine.substeps, fine.n_measured) == (10, 3, series.n_measured)
    np.testing.assert_array_equal(fine.t[fine.samples], t)
    np.testing.assert_allclose(np.diff(fine.t), np.repeat(np.diff(t) / 3.0, 3))
    np.testing.assert_array_equal(fine.y[fine.samples], y)
    assert np.isnan(np.delete(fine.y, fine.samples, axis=0)).all()
    np.testing.assert_array_equal(fine.u[:, 0], [1, 1, 1, 2, 2, 2, 3, 3, 3, 4])
    np.testing.assert_array_equal(fine.extra[:, 0], np.repeat(t, 3)[:10])
    assert fine.part(3, 10).substeps == fine.masked([0]).substeps == 3
    assert engine.Series(np.zeros(5), dt=0.1).refined(4).dt == pytest.approx(0.025)
    assert series.refined(1) is series
    with pytest.raises(engine.SeriesError, match="row 4 of a refined series is no sample"):
        fine.part(4, 10)
    with pytest.raises(engine.SeriesError, match="refined already, 3 steps a sample"):
        fine.refined(2)
    with pytest.raises(engine.SeriesError, match="k = 0 steps a sample"):
        series.refined(0)


@pytest.mark.parametrize("name", ["oscillator", "structure", "tanks"])
def test_models_that_declare_a_real_time_step_have_one(name):
    model = engine.get_model(name)
    assert model.continuous
    assert is_consistent(model, np.asarray(model.theta()), guessed_points(model, 0.05))


@pytest.mark.parametrize("name", ["mixed-4", "linear-2", "local-level"])
def test_a_step_that_is_none_is_found_out_and_kept(name):
    model = engine.get_model(name)
    assert not model.continuous
    assert not is_consistent(model, np.asarray(model.theta()), guessed_points(model, 1.0))
    series = engine.simulate(model, None, 60, np.random.default_rng(1)).series
    wrongly = replace(model, continuous=True)
    told = prepare(wrongly, Records(series), lambda: np.asarray(model.theta()))
    assert told.k == 1
    assert "two half-steps do not agree with one" in told.notes[0]


def test_an_exact_model_has_the_same_likelihood_on_a_refined_series():
    model, series = engine.get_model("oscillator"), swings()
    thetas = np.asarray(model.theta())[None]
    plain = moment_filter(model, thetas, series).log_likelihood[0]
    for k in (2, 5):
        fine = moment_filter(model, thetas, series.refined(k)).log_likelihood[0]
        assert fine == pytest.approx(plain, abs=1e-4)


@pytest.mark.parametrize(
    "own",
    [
        {"lag_y": 0.6},
        {"delay_y": 3.0, "delay_y_samples": 3.0},
        {"delay_drive": 1.0},
        {"delay_drive": 3.0, "delay_drive_samples": 3.0},
        {"hold_drive": 1.0},
        {"pulse_y": 0.3, "pulse_y_time": 4.0},
        {"pulse_velocity": 3.0, "pulse_velocity_time": 4.0},
    ],
    ids=lambda own: "-".join(own),
)
def test_what_counts_samples_counts_them_on_a_refined_series_too(own):
    model, series = engine.get_model("oscillator"), swings()
    theta = np.asarray(model.theta())
    kind, _, channel = next(iter(own)).partition("_")
    values = []
    for k in (1, 4):
        refined = series.refined(k)
        extended = make_effect(f"{kind}:{channel}", setting_for(model, refined, theta)).apply(model)
        at = np.asarray(extended.theta(own))[None]
        values.append(moment_filter(extended, at, refined).log_likelihood[0])
    change = values[0] - moment_filter(model, theta[None], series).log_likelihood[0]
    # a pulse of force acts at a sample's start, or all through it
    within = 0.1 * abs(change) if channel == "velocity" else 1e-3
    assert abs(change) > 1.0
    assert values[1] == pytest.approx(values[0], abs=within)


@pytest.mark.long
def test_samples_at_no_common_step_get_several_steps_too():
    """Once they got one each, whose error with inputs on a straight line was named a direct path."""
    series, model = swings(dt=0.5).replace(hold="foh"), engine.get_model("oscillator")
    theta = np.asarray(model.theta())
    irregular = series.replace(t=series.t + 0.1 * np.sin(np.arange(len(series))))
    usual, told = (prepare(model, Records(one), lambda: theta) for one in (series, irregular))
    assert min(usual.k, told.k) > 1
    assert "nothing that counts samples (lag, delay, play)" in told.notes[1]
    # what counts samples cannot tell them from the steps between
    counting = {
        k: {e.kind for e in all_effects(setting_for(model, irregular.refined(k), theta))}
        & set(COUNTING)
        for k in (1, told.k)
    }
    assert counting == {1: {"lag", "delay", "play"}, told.k: set()}
    with pytest.raises(OptionError, match="counts samples, which are at no common step"):
        make_effect("lag:y", setting_for(model, irregular.refined(2), theta))


def test_so_many_samples_are_no_time_where_steps_grow():
    """As of a drug's curve, from minutes to hours: a slow input was named a delay of 1.8 samples."""
    model, series = engine.get_model("oscillator"), swings().part(0, 40)
    theta = np.asarray(model.theta())
    growing = series.replace(t=1e-3 * 1.2 ** np.arange(40.0))
    known = setting_for(model, growing, theta)
    assert not known.tells_samples
    assert not {e.kind for e in all_effects(known)} & set(COUNTING)
    told = prepare(model, Records(growing), lambda: theta)
    assert any("nothing that counts samples (lag, delay, play)" in note for note in told.notes)
    assert setting_for(replace(model, continuous=False), growing, theta).tells_samples


@pytest.mark.slow
def test_the_page_says_what_is_wrong_with_the_steps_that_were_fitted():
    """Once the first section was made with one step a sample, and a clean record looked all wrong.

    Of a pendulum by another program, six samples a period; refined by the user or not, the answer is the same.
    """
    model = engine.continuous(
        name="swing",
        drift=lambda a, u, t, th: ([0.0, 4.0 * u[0] - th.g * np.sin(a[:, 0])], [[1.0], [-th.c]]),
        diffusion=lambda a, u, t, th: np.diag([0.0, th.q]),
        measurement=lambda a, u, t, th: ([a[:, 0]], [[0.0]], [[th.r]]),
        initial=lambda th: (engine.Gaussian([0.0], [[0.1]]), [0.0], [[0.1]]),
        nonlinear={"angle": "rad"},
        linear={"rate": "rad/s"},
        inputs={"torque": "1"},
        outputs={"y": "rad"},
        parameters=[
            engine.Parameter("g", 8.5, "1/s^2", (0.0, 100.0)),
            engine.Parameter("c", 0.4, "1/s", (0.0, 10.0)),
            engine.Parameter("q", 1e-3, "1/s^3", (0.0, 1.0)),
            engine.Parameter("r", 1e-4, "rad^2", (1e-8, 1.0)),
        ],
    )
    series = by_runge_kutta(120, 0.35)
    found = [
        engine.diagnose(model, one, effects=["drag", "bias"], max_effects=1)
        for one in (series, series.refined(2))
    ]
    assert found[0].substeps > 1
    (run,) = found[0].symptoms.free_run.fits
    assert run.rmse < 2.0 * run.expected_rmse
    assert found[0].symptoms.whiteness[0].variance < 2.0
    assert len(found[0].symptoms.z) == len(found[0].symptoms.series) < len(series)
    assert len(found[0].symptoms.of_states) == len(found[0].symptoms.z) - 1
    assert str(found[1]).split("Notes")[0] == str(found[0]).split("Notes")[0]


def test_a_model_that_counts_samples_takes_series_of_its_own_steps_only():
    """Once a delay of three samples was one of three steps, a fourth of it, and others paid for it."""
    model, series = engine.get_model("oscillator"), swings()
    theta = np.asarray(model.theta())
    own = {"delay_y": 3.0, "delay_y_samples": 3.0}
    late = extend(model, ["delay:y"], setting_for(model, series, theta))
    at = late.theta(own)
    with pytest.raises(SeriesError, match="4 steps a sample"):
        engine.free_run(late, at, series.refined(4))
    finer = extend(model, ["delay:y"], setting_for(model, series.refined(4), theta))
    with pytest.raises(SeriesError, match="remembers samples of 4 steps"):
        engine.free_run(finer, at, series)
    runs = [engine.free_run(late, at, series), engine.free_run(finer, at, series.refined(4))]
    np.testing.assert_allclose(runs[1].y[::4], runs[0].y, atol=1e-6 * np.std(runs[0].y))
    told = engine.fit_simulation(late, series, at, free=["delay_y"], n_starts=0)
    assert "too long" not in told.message
    assert prepare(late, Records(series), lambda: np.asarray(at)).k == 1


@pytest.mark.parametrize("linear", [False, True], ids=["nonlinear", "linear"])
@pytest.mark.parametrize(
    ("name", "own"),
    [
        ("drag:{}", (0.6,)),
        ("cubic:{}", (-0.4,)),
        ("hysteresis:{}", (-8.0, 0.4)),
        ("boucwen:{}", (-8.0, 0.4, -0.5)),
        ("pole:{}", (2.0, 1.0)),
        ("mode:{}", (4.0, 0.2, 0.3)),
        ("path:{}->{}", (-4.0, 0.5)),
    ],
    ids=["drag", "cubic", "hysteresis", "boucwen", "pole", "mode", "path"],
)
def test_the_error_of_an_effect_falls_with_the_square_of_the_step(name, own, linear):
    """In all states at the samples, as Strang's splitting does it, whatever the rest of the model is."""
    model = engine.get_model("oscillator") if linear else pendulum(continuous=True)
    state = "velocity" if linear else "rate"
    name = name.format(*model.inputs, state) if "->" in name else name.format(state)
    n, theta = 100, np.asarray(model.theta())
    model_states = [*model.nonlinear, *model.linear]
    series = engine.Series(np.zeros(n), 2.0 * np.sin(0.13 * np.arange(n)), dt=0.1)
    runs = []
    for k in (1, 2, 4, 32):
        fine = series.refined(k)
        extended = extend(model, [name], setting_for(model, fine, theta))
        start = np.asarray(extended.theta())
        start[len(theta) : len(theta) + len(own)] = own
        run = engine.free_run(extended, start, fine)
        states = np.concatenate([run.a, run.z], axis=1)[fine.samples]
        names = [*extended.nonlinear, *extended.linear]
        runs.append(states[:, [names.index(one) for one in model_states]])
    *coarse, exact = runs
    errors = [np.sqrt(np.mean((run - exact) ** 2, axis=0)) for run in coarse]
    assert (errors[0] < 0.1 * exact.std(axis=0)).all()
    assert (errors[1] < errors[0] / 2.5).all()
    assert (errors[2] < errors[1] / 2.5).all()


@pytest.mark.parametrize("kind", ["drag", "stribeck", "coulomb", "hysteresis", "pole"])
def test_rows_are_kept_apart_where_some_are_moved_by_linear_states(kind):
    """A state that a linear one multiplies: it does not move where it is zero."""

    def dynamics(a, u, t, dt, th):
        A = np.zeros((len(a), 2, 1))
        A[:, 0, 0], A[:, 1, 0] = dt * a[:, 0], 1.0
        return np.stack([a[:, 0], np.zeros(len(a))], axis=1), A, dt * np.diag([0.1, 0.1])

    model = engine.MixedModel(
        name="multiplied",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 1)), [[0.1]]),
        initial=lambda th: (engine.Gaussian([1.0], [[1.0]]), [0.0], [[1.0]]),
        nonlinear={"x": "m"},
        linear={"rate": "1/s"},
        outputs={"y": "m"},
        parameters=[],
        continuous=True,
    )
    effect = make_effect(f"{kind}:x", Setting(model, dt=0.1, span=(0.0, 10.0)))
    extended = effect.apply(model)
    theta = extended.record([0.5, *(p.default for p in effect.parameters[1:])])
    a = np.zeros((4, extended.na))
    a[:, 0] = [0.0, 1.0, -2.0, 1e-3]
    together = extended.transition(a, np.zeros(0), 0.0, 0.1, theta)
    for m, row in enumerate(a):
        alone = extended.transition(row[None], np.zeros(0), 0.0, 0.1, theta)
        for one, every, dims in zip(alone, together, (1, 2, 2), strict=True):
            own = every[m] if every.ndim > dims else every
            np.testing.assert_allclose(one[0] if one.ndim > dims else one, own, rtol=1e-12)


@pytest.mark.parametrize("speed", [0.0, 1e-9, -1e-9, 0.3])
def test_dry_friction_near_rest_does_not_throw_what_a_linear_state_pushes(speed):
    """Its sign jumps there: a difference across that, over a small way, was hundreds of times the push."""

    def dynamics(a, u, t, dt, th):
        return [a[:, 0] - dt * 0.5 * np.sign(a[:, 0]) + dt * u[0]], np.zeros((1, 0)), [[dt * 1e-4]]

    model = engine.MixedModel(
        name="rubbing",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[1e-4]]),
        initial=lambda th: (engine.Gaussian([0.0], [[1e-4]]), [], np.zeros((0, 0))),
        nonlinear={"v": "m/s"},
        inputs={"u": "m/s^2"},
        outputs={"y": "m/s"},
        parameters=[],
        continuous=True,
    )
    at = np.array([[speed]]), np.array([0.4]), 0.0, 0.1, model.record([])
    on = carried(model, 0, model.transition(*at), *at)
    np.testing.assert_allclose(on, [[1.0]], rtol=1e-6)


def slipping(n=200, dt=0.05):
    """A pendulum with a stiff spring that slips, in steps of dt / 64; the values of the hidden effect."""
    model, t = with_noise(pendulum(continuous=True)), dt * np.arange(n)
    u = 1.5 * np.sin(0.9 * t) + 0.8 * np.sin(2.3 * t + 1.0)
    fine = engine.Series(np.zeros(n), u, dt=dt, hold="foh").refined(64)
    theta = np.asarray(model.theta())
    hidden = extend(model, ["boucwen:rate"], setting_for(model, fine, theta))
    values = np.asarray(hidden.theta())
    values[len(theta) : len(theta) + 3] = (-8.0, 0.4, -0.5)
    y = engine.free_run(hidden, values, fine).y[fine.samples, 0]
    y += 2e-4 * np.random.default_rng(5).standard_normal(n)
    return model, engine.Series(y, u, dt=dt, hold="foh"), values


@pytest.mark.long
def test_steps_may_be_short_enough_for_a_model_and_too_long_for_what_it_lacks():
    model, series, values = slipping()
    theta = values[: len(model.parameters)]
    assert prepare(model, Records(series), lambda: theta).k == 1
    told = [
        are_too_long(model, ["boucwen:rate"], values, series.refined(k), np.array([0.2, 0.0, 0.0]))
        for k in (1, 2, 16)
    ]
    assert told == [True, True, False]
    k = steps_for(model, ["boucwen:rate"], values, series, np.array([0.2, 0.0, 0.0]))
    assert 2 < k <= 16  # at once, not by twice as many again and again
    assert not are_too_long(model, [], theta, series, np.array([0.2, 0.0]))


@pytest.mark.slow
def test_steps_are_chosen_again_for_what_was_found():
    model, series, _ = slipping()
    options = {"effects": ["boucwen", "drag"], "max_effects": 1, "seed": 1}
    kept = {}
    found = engine.diagnose(model, series, kept=kept, **options)
    k = found.substeps
    assert k > 1
    assert f"{k} steps a sample: with fewer, their error is in what is found" in " ".join(
        found.notes
    )
    (cause,) = found.causes
    assert cause.effect == "boucwen:rate"
    assert cause.size == pytest.approx(-8.0, abs=0.02)
    assert any(name.startswith(f"{k} steps a sample: round 1") for name in kept)
    again = engine.diagnose(model, series, kept=dict(kept), **options)
    assert np.asarray(again.theta).tolist() == np.asarray(found.theta).tolist()


def test_a_rule_for_the_noise_that_ends_up_near_will_do():
    """Simpson's, of noise that reaches a state through two others: 4 % too much of almost nothing."""
    drift = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])

    def dynamics(a, u, t, dt, th, rule=None):
        def power(h):
            return np.eye(3) + h * drift + 0.5 * h**2 * drift @ drift

        Qc = np.diag([0.0, 0.0, 1.0])
        whole, half = power(dt), power(0.5 * dt)
        Q = dt / 6.0 * (Qc + 4.0 * half @ Qc @ half.T + whole @ Qc @ whole.T)
        return np.zeros(3), whole, Q * (1.0 if rule is None else rule(dt))

    def told(rule):
        model = engine.MixedModel(
            name="thrice integrated",
            dynamics=lambda *args: dynamics(*args, rule=rule),
            measurement=lambda a, u, t, th: (np.zeros(1), np.eye(3)[:1], [[1e-2]]),
            initial=lambda th: (engine.Gaussian([], np.zeros((0, 0))), np.ones(3), np.eye(3)),
            linear=dict.fromkeys(("x", "v", "force"), "1"),
            outputs={"y": "1"},
            parameters=[],
            continuous=True,
        )
        return is_consistent(model, np.zeros(0), guessed_points(model, 0.5))

    assert told(None)
    assert not told(lambda dt: dt)  # of order dt^2
    assert not told(lambda dt: 1.0 / dt)  # as much in any step


def test_times_and_frequencies_are_tried_at_samples():
    model, series = engine.get_model("oscillator"), swings()
    setting = setting_for(model, series, np.asarray(model.theta()))
    for name in ("step:y", "harmonic:y"):
        effect = make_effect(name, setting)
        np.testing.assert_allclose(grid(effect, series.refined(4)), grid(effect, series))


@pytest.mark.slow
def test_drag_on_a_pendulum_leaves_nothing_for_hysteresis_to_explain():
    """Runge-Kutta's own drag, 16 samples a period; an effect once entered by one Euler step a sample."""
    series = by_runge_kutta(200, 0.13, drag=0.3)
    model = with_noise(pendulum(continuous=True))
    base = quasi_ml(model, series)
    fine = prepare(model, Records(series), lambda: np.asarray(base.theta))
    assert fine.k > 1
    assert "steps a sample" in fine.notes[0]
    base = quasi_ml(model, fine.records.main, base.theta)
    gain, fit = gained(base, fine.records.main, "drag:rate", [{"drag_rate": 0.2}])
    assert gain > 20.0
    size = fit.theta["drag_rate"]
    assert abs(size - 0.3) < 3.0 * fit.standard_errors[fit.free.index("drag_rate")]
    setting = setting_for(model, fine.records.main, np.asarray(base.theta))
    way = [{"hysteresis_rate": 2.0}]
    assert gained(fit, fine.records.main, "hysteresis:rate", way, setting)[0] < 5.0


@pytest.mark.long
def test_a_time_step_that_is_too_long_is_a_cause_of_its_own():
    """Of a clean record a missing pole was once named, with the size 7.1 +- 7.9."""
    series = by_runge_kutta(200, 0.04)
    model = with_noise(pendulum(), euler=True)
    base = quasi_ml(model, series)
    gain, fit = gained(base, series, "time-step:dt", [{"time_step_dt": 1.0}])
    assert 1.0 < fit.theta["time_step_dt"] < 2.6
    way = [{"pole_rate": 5.0, "pole_rate_time": 0.3}]
    assert gain > gained(base, series, "pole:rate", way)[0] + 5.0


def test_where_halving_a_step_means_nothing_it_is_not_asked():
    def asked(model, dt):
        series = engine.simulate(
            model, None, 60, np.random.default_rng(1), u=np.ones((60, model.nu)), dt=dt
        ).series
        setting = setting_for(model, series, np.asarray(model.theta()))
        return [effect.name for effect in all_effects(setting, ["time-step"])]

    assert asked(engine.get_model("structure"), 0.05) == []  # exact for any dt
    assert asked(engine.get_model("mixed-4"), 1.0) == []  # dt is none
    assert asked(pendulum(), 0.1) == ["time-step:dt"]


def test_what_is_hidden_in_a_continuous_model_acts_within_the_step():
    """Against the differential equation, in steps of a thousandth of a second."""
    model, dt = engine.get_model("oscillator"), 0.1
    quiet = {"sigma_v": 1e-6, "sigma_y": 2e-4}
    u = np.repeat([1.0, -1.0, 0.5], 10)
    run = hide(
        model,
        ["drag:velocity"],
        {"drag_velocity": 0.5},
        30,
        np.random.default_rng(4),
        theta=quiet,
        u=u,
        dt=dt,
    )
    assert run.series.dt == pytest.approx(dt)
    x, v = run.a[0]  # drag made the velocity a nonlinear state
    positions = []
    for one in u:
        positions.append(x)
        for _ in range(100):
            v += 1e-3 * (-36.0 * x - 0.6 * v + 36.0 * one - 0.5 * v * abs(v))
            x += 1e-3 * v
    assert np.ptp(positions) > 1.0
    np.testing.assert_allclose(run.a[:, 0], positions, atol=0.02)


def test_steps_enough_for_the_model_may_be_too_few_for_what_was_found():
    base = engine.get_model("oscillator")
    model = extend(base, ["cubic:position->velocity"])
    theta = np.asarray(model.theta({"cubic_position__velocity": -30.0, "sigma_v": 1e-6}))
    series = swings(dt=0.2)
    fine = series.refined(32)
    run = engine.free_run(model, model.theta(theta), fine, a1=np.zeros(1), z1=np.zeros(1))
    noise = 0.03 * np.random.default_rng(1).standard_normal(len(series))
    measured = series.replace(y=run.y[fine.samples] + noise[:, None])
    assert not is_enough(model, theta, measured, 1)
    assert is_enough(model, theta, measured, 16)


@pytest.mark.long
def test_how_many_steps_are_enough_has_nothing_to_do_with_the_unit_of_time():
    """An effect of size 1 in seconds is far too large for a step of five minutes: its error says nothing."""
    u = np.repeat(np.random.default_rng(2).uniform(0.0, 2.0, 10), 12)
    told = {}
    for unit, second in (("s", 1.0), ("h", 1.0 / 3600.0)):
        model = heated(second)
        y = engine.simulate(
            model, None, 120, np.random.default_rng(3), u=u, dt=300.0 * second
        ).series.y
        series = engine.Series(y, u, dt=300.0 * second)
        setting = setting_for(model, series, np.asarray(model.theta()))
        sizes = {e.size.name: s for e, s in substeps._sized(setting, np.asarray(model.theta()))}
        told[unit] = sizes, substeps.choose(setting, series, np.asarray(model.theta()))
    assert told["s"][1] == told["h"][1] == 1
    force = told["s"][0]["force_air"]
    assert told["h"][0]["force_air"] == pytest.approx(3600.0 * force, rel=1e-3)
    assert told["h"][0]["drag_air"] == pytest.approx(3600.0 * told["s"][0]["drag_air"], rel=0.05)


@pytest.mark.parametrize("scale", [1e-30, 1e-3, 1.0, 1e30])
def test_a_size_is_found_whatever_its_unit(scale):
    """Above rounding, and below what overflows; of an effect that does nothing there is none."""

    def change(size):
        own = size * scale
        return float(1.0 + np.expm1(own) - 1.0) if own < 700.0 else np.inf  # lost below 1e-16

    assert substeps._reaching(0.02, change) * scale == pytest.approx(0.02, rel=0.05)
    assert substeps._reaching(0.02, lambda size: 0.0) is None
