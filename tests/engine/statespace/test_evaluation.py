"""Users' functions as users write them: evaluated right, whatever they take, or refused."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

import engine
from engine import Gaussian, MixedModel, Parameter, Series
from engine.errors import ModelError
from engine.estimation.expectation import dependence, expectation
from engine.estimation.quasi_ml import quasi_ml
from engine.estimation.start import WarmStart
from engine.filters.sigma_point import moment_filter
from engine.simulation.free_run import run_rows
from engine.simulation.simulate import propagate
from engine.statespace.model import as_matrix, as_rows
from engine.statespace.points import Points
from engine.statespace.rows import Rows
from engine.statespace.trial import Trial

NX, LIMIT = 2, 0.7


# ---- ways to write x1' = s x1 + b u + g z, z' = 0.8 z, with s, b, g depending on theta, u or t -------

FACTORS = {  # of x1, from (u, t, theta): what is written with numbers in mind, and what is not
    "array": lambda u, t, th: np.cos(th.w),
    "math": lambda u, t, th: math.cos(th.w),
    "float": lambda u, t, th: float(th.w) * 0.5,
    "if theta": lambda u, t, th: 0.5 if th.w > 0.8 else th.w,
    "max": lambda u, t, th: max(th.w, 0.8),
    "if u": lambda u, t, th: 0.3 * th.w if u[0] > 0.2 else 0.7,
    "if t": lambda u, t, th: 0.3 * th.w if t > 5.0 else 0.7,
    "norm of u": lambda u, t, th: 0.5 + 0.1 * th.w * np.linalg.norm(u),
    "mean of u": lambda u, t, th: 0.5 + 0.1 * np.mean(u),
    "dot": lambda u, t, th: np.dot([0.1, 0.2], u) + th.w,
    "any": lambda u, t, th: 0.4 + 0.3 * np.any(u > 1.0),
    "at least 1d": lambda u, t, th: np.atleast_1d(th.w)[0],
    "matrix of theta": lambda u, t, th: np.linalg.det(np.array([[th.w, 0.1], [0.2, 1.0]])),
    "where": lambda u, t, th: np.where(u[0] > 0.2, 0.3, 0.6) * th.w,
}

VALUES = {  # f from its two rows
    "list": lambda a, rows: rows,
    "tuple": lambda a, rows: tuple(rows),
    "columns": lambda a, rows: np.stack([0.0 * a[:, 0] + row for row in rows], axis=1),
    "single precision": lambda a, rows: np.stack([0.0 * a[:, 0] + r for r in rows], axis=1).astype(
        "f"
    ),
}

NOISES = {  # Q from theta
    "nested": lambda a, th: [[0.1, 0.0], [0.0, th.q]],
    "diag": lambda a, th: np.diag([0.1, th.q]),
    "times eye": lambda a, th: th.q * np.eye(2),
    "object": lambda a, th: np.array([[0.1, 0], [0, float(th.q)]]),
    "integers": lambda a, th: np.array([[1, 0], [0, 2]]),
    "of a": lambda a, th: [[0.1 + 0.01 * a[:, 0] ** 2, 0.0], [0.0, th.q]],
}


def user_model(
    factor="array", value="list", noise="nested", writes=False, keeps=False
) -> MixedModel:
    """A model in one of the styles; ``writes`` into a, ``keeps`` the memory of what it returns."""
    kept: dict[int, np.ndarray] = {}

    def dynamics(a, u, t, dt, theta):
        x = a[:, 0]
        if writes:
            a *= FACTORS[factor](u, t, theta)
            first = x + 0.4 * u[1] * dt
        else:
            first = FACTORS[factor](u, t, theta) * x + 0.4 * u[1] * dt
        f = VALUES[value](a, [first, 0.0])
        if keeps:
            out = kept.setdefault(len(a), np.empty((len(a), 2)))
            out[:, 0], out[:, 1] = first, 0.0
            f = out
        return f, [[0.3], [0.8]], NOISES[noise](a, theta)

    def measurement(a, u, t, theta):
        return [a[:, 0] + FACTORS[factor](u, t, theta)], [[0.5]], [[0.2]]

    def initial(theta):
        return Gaussian([0.4], [[0.5]]), [0.1], [[0.3]]

    return MixedModel(
        name="a-users",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"x": "m"},
        linear={"z": "m"},
        inputs={"u1": "V", "u2": "V"},
        outputs={"y": "m"},
        parameters=[Parameter("w", 0.9, "1", (0.1, 1.5)), Parameter("q", 0.3, "1", (0.01, 2.0))],
    )


def row_by_row(model, a, u, t, dt, thetas):
    """F, A, Q (M, ., .) from calls of single rows of the user's own function."""
    f, A, Q = np.empty((len(a), NX)), np.empty((len(a), NX, 1)), np.empty((len(a), NX, NX))
    for i in range(len(a)):
        one = model.dynamics(a[i : i + 1].copy(), u[:, i], float(t[i]), dt, model.record(thetas[i]))
        f[i] = as_rows(one[0], 1, NX, "f")
        A[i], Q[i] = as_matrix(one[1], 1, NX, 1, "A"), as_matrix(one[2], 1, NX, NX, "Q")
    return f, A, Q


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    factor=st.sampled_from(sorted(FACTORS)),
    value=st.sampled_from(sorted(VALUES)),
    noise=st.sampled_from(sorted(NOISES)),
    writes=st.booleans(),
    keeps=st.booleans(),
    calls=st.lists(
        st.tuples(st.booleans(), st.booleans(), st.integers(1, 7)), min_size=1, max_size=4
    ),
    seed=st.integers(0, 10**6),
)
def test_rows_of_any_times_and_parameters_are_what_each_row_is(
    factor, value, noise, writes, keeps, calls, seed
):
    """Whatever is together in a call: some times, some parameters, both, neither."""
    model, rng = user_model(factor, value, noise, writes, keeps), np.random.default_rng(seed)
    earlier = []
    for times, parameters, M in calls:
        a = rng.standard_normal((M, 1))
        u, t = rng.standard_normal((2, M)), rng.uniform(0.0, 10.0, M)
        u[:, rng.random(M) < 0.5] = 0.0
        thetas = np.asarray(model.theta()) * rng.uniform(0.6, 1.5, (M, 2))
        if not times:
            u[:], t[:] = u[:, :1], t[0]
        if not parameters:
            thetas[:] = thetas[0]
        given_a, given_u = a.copy(), u.copy()
        got = model.transition(
            a,
            u if times else u[:, 0].copy(),
            t if times else float(t[0]),
            0.1,
            model.records(thetas),
        )
        expected = row_by_row(model, given_a, given_u, t, 0.1, thetas)
        np.testing.assert_array_equal(a, given_a)
        np.testing.assert_array_equal(u, given_u)
        rtol = 1e-5 if value == "single precision" else 1e-9
        for x, y in zip(got, expected, strict=True):
            np.testing.assert_allclose(np.broadcast_to(x, y.shape), y, rtol=rtol, atol=1e-300)
        earlier.append((got, tuple(x.copy() for x in got)))
    if any(
        M > 1 for _, _, M in calls[:1]
    ):  # memory that is used again shows at the first such call
        for now, then in earlier:
            for x, y in zip(now, then, strict=True):
                np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize(
    "first",
    [
        lambda a: 0.9 * a[0],
        lambda a: a[:, 0] * (0.9 if a[0, 0] > LIMIT else 0.5),
        lambda a: a[:, 0] - 0.1 * np.linalg.norm(a),
        lambda a: a[:, 0] - 0.1 * np.any(a[:, 0] > LIMIT),
        lambda a: a[:, 0] - a[:, 0].mean(),
        lambda a: np.sort(a[:, 0]),
    ],
)
def test_particles_that_influence_each_other_are_refused(first):
    model = user_model()

    def dynamics(a, u, t, dt, theta):
        return [first(a), 0.0], [[0.3], [0.8]], 0.1 * np.eye(2)

    series = Series(np.zeros((40, 1)), np.ones((40, 2)), dt=0.1)
    with pytest.raises(
        ModelError, match=r"'a-users', dynamics: .* depends on the other rows.*a\[:, 0\]"
    ):
        engine.rbpf(replace(model, dynamics=dynamics), None, series, 50, np.random.default_rng(0))


@pytest.mark.parametrize("size", [1e3, 1e34])
def test_a_particle_that_has_run_away_is_not_taken_for_one_that_others_influence(size):
    """Its rounding is that of its own size: beyond all that the other particles are."""
    a = np.linspace(0.5, 1.5, 40)[:, None]
    a[7] = size
    theta = user_model().record(user_model().theta())
    rows = Rows(a, np.zeros(2), 0.0, 0.1, theta)

    def regular(a, u, t, dt, theta):  # rounded otherwise where rows stand side by side
        return (a * (1.0 + (np.finfo(float).eps if len(a) > 1 else 0.0)), None, None)

    trial = Trial(regular, (np.zeros(len(theta)), np.ones(len(theta))))
    company = np.delete(np.arange(40), 7)[:20]
    alone = [(7, regular(a[7:8], *rows[1:]))]
    assert trial._like(rows, None, regular(*rows), company, alone)
    alone = [(7, regular(1.001 * a[7:8], *rows[1:]))]
    assert not trial._like(rows, None, regular(*rows), company, alone)


def test_a_condition_that_shows_late_is_found_when_states_get_there():
    """All particles are on one side of the limit at first, and on the other side later."""
    model = user_model()

    def dynamics(a, u, t, dt, theta):
        return [a[:, 0] + (0.1 if a[0, 0] < 8.0 else 0.2), 0.0], [[0.0], [0.8]], 1e-4 * np.eye(2)

    def initial(theta):
        return Gaussian([0.0], [[1e-4]]), [0.0], [[0.0]]

    model = replace(model, dynamics=dynamics, initial=initial)
    series = Series(np.full((200, 1), np.nan), np.ones((200, 2)), dt=0.1)
    series = Series(np.r_[[[0.9]], series.y[1:]], series.u, dt=0.1)
    with pytest.raises(ModelError, match="depends on the other rows"):
        engine.rbpf(model, None, series, 50, np.random.default_rng(0))


def test_records_of_numbers_and_of_rows_in_turn_are_told_apart():
    def dynamics(a, u, t, dt, theta):
        return [math.cos(theta.w) * a[:, 0], 0.0], [[0.3], [0.8]], 1e-4 * np.eye(2)

    model = replace(user_model(), dynamics=dynamics)
    a, u = np.linspace(0.1, 0.4, 4)[:, None], np.zeros(2)
    one, other = model.record(model.theta()), model.record(model.theta({"w": 0.5}))
    rows = model.records(np.array([[w, *model.theta()[1:]] for w in (0.2, 0.4, 0.6, 0.8)]))
    for record in (one, rows, one, one, other, rows, rows, other, one):
        f = model.transition(a, u, 0.0, 0.1, record)[0]
        np.testing.assert_allclose(f[:, 0], np.cos(record.w) * a[:, 0], rtol=1e-14)
    few = model.transition(a[:2], u, 0.0, 0.1, one)[0]  # the same record with other rows
    np.testing.assert_allclose(few[:, 0], np.cos(one.w) * a[:2, 0], rtol=1e-14)


# ---- the same answers, fast or slow ------------------------------------------------------------


def numbers_only(model: MixedModel) -> MixedModel:
    """The same model with functions that take the numbers of one time and one theta only."""

    def dynamics(a, u, t, dt, theta):
        return model.dynamics(a, u, float(t), float(dt), model.record([float(v) for v in theta]))

    def measurement(a, u, t, theta):
        return model.measurement(a, u, float(t), model.record([float(v) for v in theta]))

    return replace(model, dynamics=dynamics, measurement=measurement)


def drawn(model, T=60, dt=0.1, seed=0):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal((T // 4, 2)), 4, axis=0)
    u[: T // 2, 0] = 0.0
    return engine.simulate(model, None, T, rng, u=u, dt=dt).series


STYLES = [
    *((factor, "nested") for factor in sorted(FACTORS)),
    ("array", "diag"),
    ("array", "times eye"),
]


@pytest.mark.parametrize(("factor", "noise"), STYLES)
def test_all_algorithms_give_the_same_without_arrays_of_times_and_parameters(factor, noise):
    fast = user_model(factor, noise=noise)
    slow = numbers_only(fast)
    series = drawn(fast)
    # to rounding: a product of another shape may sum in another order
    np.testing.assert_allclose(series.y, drawn(slow).y, rtol=1e-13)
    thetas = np.asarray(fast.theta()) * np.random.default_rng(1).uniform(0.8, 1.2, (5, 2))
    x1 = np.tile([0.4, 0.1], (5, 1))
    results = []
    for model in (fast, slow):
        theta = model.theta()
        filtered = engine.rbpf(model, theta, series, 20, np.random.default_rng(2))
        draws = engine.condition_on_trajectories(
            engine.rb_ffbsi(filtered, 6, np.random.default_rng(3), joint=True)
        )
        q = expectation(model, theta, [(draws, Points(model, series, draws.a))])
        value, gradient, H = q.derivatives(np.asarray(theta), np.arange(2))
        results.append(
            (
                moment_filter(model, thetas, series).log_terms,
                run_rows(model, thetas, series, x1)[0],
                filtered.log_likelihood,
                draws.outputs(),
                value,
                gradient,
                H,
            )
        )
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-9 * np.abs(other).max())


def test_what_was_made_from_calls_that_turn_out_wrong_is_made_again():
    """At first no copy is beyond the limit, so that arrays of w seem to be taken."""
    model = user_model()

    def dynamics(a, u, t, dt, theta):
        slope = 0.5 + 0.2 * np.any(theta.w > 1.2)
        return [slope * a[:, 0] + 0.1 * theta.w, 0.0], [[0.3], [0.8]], 0.1 * np.eye(2)

    model = replace(model, dynamics=dynamics)
    series = drawn(model)
    near = np.array([[0.50, 0.3], [0.51, 0.3], [0.52, 0.3]])
    moment_filter(model, near, series)
    a = np.ones((3, 1))
    assert model.transitions.takes(a, series.u[0], 0.0, 0.1, model.records(near))
    apart = np.array([[0.5, 0.3], [1.4, 0.3], [0.6, 0.3]])
    got = moment_filter(model, apart, series).log_likelihood
    each = [moment_filter(model, row[None], series).log_likelihood[0] for row in apart]
    np.testing.assert_allclose(got, each, rtol=1e-12)
    assert model.transitions.recorded


@pytest.mark.parametrize("name", engine.model_names())
def test_shipped_models_are_evaluated_in_one_call(name):
    """No verdict against a function that takes everything, from rounding or anything else."""
    model = replace(engine.get_model(name))  # nothing is known of its calls yet
    rng = np.random.default_rng(0)
    series = engine.simulate(
        model, None, 60, rng, u=rng.standard_normal((60, model.nu)), dt=0.1
    ).series
    thetas = np.asarray(model.theta()) * rng.uniform(0.99, 1.01, (7, len(model.parameters)))
    thetas = np.clip(thetas, model.lower, model.upper)
    moment_filter(model, thetas, series)
    points = Points(model, series, 0.1 * rng.standard_normal((60, 7, model.na)))
    for record in (model.record(model.theta()), model.records(np.tile(thetas, (60, 1)))):
        points.observation(record)
        for function, rows, n in ((model.transitions, True, 59), (model.observations, False, 60)):
            if not (rows and np.ndim(record[0])):
                assert function.takes(*points.arguments(np.arange(n), rows), record)
    a, u = np.zeros((7, model.na)), series.u[0]
    assert model.transitions.takes(a, u, 0.0, 0.1, model.records(thetas))


def test_generators_start_again_where_they_were():
    model = user_model()
    u = np.zeros((300, 2))
    u[250:] = 2.0

    def dynamics(a, u, t, dt, theta):  # arrays of w are mixed up as soon as u is there
        w = np.mean(theta.w) if np.any(u > 1.0) else theta.w
        return [w * 0.5 * a[:, 0] + u[0], 0.0], [[0.3], [0.8]], 0.1 * np.eye(2)

    late = replace(model, dynamics=dynamics)
    series = Series(np.zeros((300, 1)), u, dt=0.1)
    thetas = np.array([[0.5, 0.3], [1.4, 0.3], [0.6, 0.3]])
    x1 = np.zeros((3, 2))
    got = propagate(
        late, late.records(thetas), series, x1[:, :1], x1[:, 1:], np.random.default_rng(5)
    )[0]
    expected = propagate(
        late, late.records(thetas), series, x1[:, :1], x1[:, 1:], np.random.default_rng(5)
    )[0]
    assert late.transitions.recorded
    np.testing.assert_array_equal(got, expected)


def test_a_parameter_at_which_a_function_has_no_value_is_lost_alone():
    model = user_model()

    def dynamics(a, u, t, dt, theta):
        return [math.sqrt(theta.w - 0.5) * a[:, 0], 0.0], [[0.3], [0.8]], 0.1 * np.eye(2)

    model = replace(model, dynamics=dynamics)
    series = drawn(model)
    thetas = np.array([[0.9, 0.3], [0.2, 0.3], [0.7, 0.3]])
    got = moment_filter(model, thetas, series).log_likelihood
    assert np.isneginf(got[1])
    assert np.isfinite(got[[0, 2]]).all()
    with pytest.raises(ModelError, match=r"dynamics raised ValueError: .*called at t = 0"):
        moment_filter(model, thetas[1:2], series)


def test_verdicts_are_not_pickled_and_models_are():
    model = engine.get_model("mixed-4")
    model.transition(np.zeros((3, 1)), np.zeros(0), 0.0, 1.0, model.record(model.theta()))
    again = pickle.loads(pickle.dumps(model))
    assert "transitions" not in vars(again)
    np.testing.assert_array_equal(again.theta(), model.theta())


# ---- the failures that were reported --------------------------------------------------------------


def glider(noise):
    """README's glider with its Q written in one way or another."""

    def dynamics(a, u, t, dt, theta):
        f = [a[:, 0] - dt * theta.c * a[:, 0] * abs(a[:, 0]) + dt * u[0], 0.0]
        return f, [[dt], [0.95]], noise(theta)

    return MixedModel(
        name="glider",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([a[:, 0]], [[0.0]], [[theta.r]]),
        initial=lambda theta: (Gaussian([0.0], [[0.1]]), [0.0], [[0.1]]),
        nonlinear={"speed": "m/s"},
        linear={"wind": "m/s^2"},
        inputs={"thrust": "m/s^2"},
        outputs={"reading": "m/s"},
        parameters=[
            Parameter("c", 0.1, "1/m", (0, 5)),
            Parameter("q", 0.01, "", (0, 1)),
            Parameter("r", 0.01, "(m/s)^2", (1e-6, 1)),
        ],
    )


def expm_of_scalars(theta):
    from scipy.linalg import expm

    return expm(np.diag([math.log(1e-4), math.log(theta.q + 1e-12)]))


@pytest.mark.parametrize(
    "noise",
    [
        lambda th: np.diag([1e-4, th.q]),
        lambda th: np.array([[1e-4, 0.0], [0.0, th.q]]),
        lambda th: [[1e-4, 0.0], [0.0, max(th.q, 1e-12)]],
        expm_of_scalars,
    ],
)
def test_the_gliders_estimate_does_not_depend_on_how_it_is_written(noise):
    plain, model = glider(lambda th: [[1e-4, 0.0], [0.0, th.q]]), glider(noise)
    u = 2 + np.sin(0.3 * np.arange(60))
    series = engine.simulate(plain, {"c": 0.3}, 60, np.random.default_rng(0), u=u, dt=0.1).series
    fits = [quasi_ml(one, series) for one in (plain, model)]
    assert fits[1].converged
    np.testing.assert_allclose(fits[1].theta, fits[0].theta, rtol=1e-5)


def test_the_gliders_warm_start_is_found():
    model = glider(lambda th: np.diag([1e-4, max(th.q, 1e-12)]))
    u = 2 + np.sin(0.3 * np.arange(25))
    series = engine.simulate(model, {"c": 0.3}, 25, np.random.default_rng(0), u=u, dt=0.1).series
    ahead = WarmStart(model, [series], np.array([0, 2]))
    found = ahead(model.theta())
    assert ahead.note == ""
    assert found
    assert found[0]["c"] != 0.1


def test_three_copies_of_a_parameter_make_no_matrix():
    """na = 0, nz = 3 and Q = q I: theta and its two neighbours look like the diagonal of Q."""

    def dynamics(a, u, t, dt, theta):
        return [0.0, 0.0, 0.0], 0.9 * np.eye(3), theta.q * np.eye(3)

    model = MixedModel(
        name="three",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([0.0, 0.0, 0.0], np.eye(3), 0.1 * np.eye(3)),
        initial=lambda theta: (Gaussian([], np.zeros((0, 0))), np.zeros(3), np.eye(3)),
        linear={"x": "1", "y": "1", "z": "1"},
        outputs={"a": "1", "b": "1", "c": "1"},
        parameters=[Parameter("q", 0.3, "", (1e-6, 10.0))],
    )
    series = engine.simulate(model, {"q": 0.4}, 40, np.random.default_rng(0)).series
    fit = quasi_ml(model, series)
    exact = engine.rts_em(model, series, n_iterations=100, tolerance=1e-7)
    assert fit.converged
    assert abs(fit.theta[0] / 0.3 - 1.0) > 0.05
    np.testing.assert_allclose(fit.theta, exact.theta, rtol=5e-3)


def test_a_norm_of_the_input_is_that_of_one_time():
    model = user_model("norm of u")
    u = np.zeros((200, 2))
    u[77], u[140:150] = 2.0, 1.0
    series = Series(np.zeros((200, 1)), u, dt=0.1)
    a = np.random.default_rng(0).standard_normal((200, 4, 1))
    record = model.record(model.theta())
    got = Points(model, series, a).transition(record)[0]
    for t in range(199):
        each = model.transition(a[t], u[t], float(series.t[t]), 0.1, record)[0]
        np.testing.assert_allclose(got[t], each, rtol=1e-12)


def test_a_parameter_that_is_used_at_few_points_only_is_not_overlooked():
    model = user_model()

    def dynamics(a, u, t, dt, theta):
        f = 0.5 * a[:, 0]
        if np.any(a[:, 0] > 3.0):
            f = f - theta.w * np.maximum(a[:, 0] - 3.0, 0.0)
        return [f, 0.0], [[0.3], [0.8]], 0.1 * np.eye(2)

    model = replace(model, dynamics=dynamics)
    a = np.zeros((50, 4, 1))
    points = Points(model, Series(np.zeros((50, 1)), np.zeros((50, 2))), a)
    assert not dependence(model, model.theta(), [points])[1].any()
    few, a = points, a.copy()
    a[31, 2] = 4.0
    points = Points(model, Series(np.zeros((50, 1)), np.zeros((50, 2))), a)
    np.testing.assert_array_equal(dependence(model, model.theta(), [points])[1], [True, False])
    both = [few, points]  # in one record of several only
    np.testing.assert_array_equal(dependence(model, model.theta(), both)[1], [True, False])


@pytest.mark.parametrize("uses", [True, False])
def test_to_ask_what_a_recorded_function_uses_does_not_keep_it_from_being_recorded(uses):
    model = user_model()

    def dynamics(a, u, t, dt, theta):
        return (
            [(theta.w if uses else 0.5) * a[:, 0] + math.sin(u[0]), 0.0],
            [[0.3], [0.8]],
            0.1 * np.eye(2),
        )

    model = replace(model, dynamics=dynamics)
    u = np.random.default_rng(1).uniform(size=(50, 2))
    points = Points(model, Series(np.zeros((50, 1)), u), np.ones((50, 4, 1)))
    for _ in range(2):
        used = dependence(model, model.theta(), [points])[1]
        np.testing.assert_array_equal(used, [uses and p.name == "w" for p in model.parameters])
    assert model.transitions.recorded


def test_a_loop_over_rows_is_tried_on_few_of_them():
    model, calls = user_model(), []

    def dynamics(a, u, t, dt, theta):
        if isinstance(u, np.ndarray) and u.ndim > 1:
            calls.append(len(a))
        f = np.array([x + float(u[0]) for x in a[:, 0].tolist()])
        return [f, 0.0], [[0.3], [0.8]], 0.1 * np.eye(2)

    model = replace(model, dynamics=dynamics)
    u = np.random.default_rng(1).uniform(size=(500, 2))
    points = Points(model, Series(np.zeros((500, 1)), u), np.ones((500, 4, 1)))
    points.transition(model.record(model.theta()))
    assert calls
    assert max(calls) < 100


def test_functions_that_use_no_parameter_are_asked_for_all_of_them_at_once():
    model, calls = engine.get_model("mixed-4"), []

    def measurement(a, u, t, theta):
        calls.append(len(a))
        return model.measurement(a, u, t, theta)

    counted = replace(model, measurement=measurement)
    points = Points(counted, Series(np.zeros((50, 2))), np.zeros((50, 4, 1)))
    assert not dependence(counted, counted.theta(), [points])[2].any()
    calls.clear()
    dependence(counted, counted.theta(), [points])
    assert len(calls) == 2  # at a few points, then at all


def test_a_warm_start_that_cannot_be_looked_for_says_so(monkeypatch):
    model = user_model()
    series = drawn(model)

    def lost(*arguments):
        raise ModelError("the moment filter is lost")

    monkeypatch.setattr("engine.estimation.start.log_likelihoods", lost)
    found = engine.rbps_em(model, series, n_particles=10, n_iterations=1)
    assert "no better start could be searched for: the moment filter is lost" in found.message


# ---- in other units ---------------------------------------------------------------------------------

POWER = st.integers(-9, 9).map(lambda k: 10.0**k)


def in_other_units(
    model: MixedModel, x: float, z: float, u: float, y: float, t: float
) -> MixedModel:
    """The model for states, inputs, outputs and times that are so many times as large."""
    X = np.array([x, z])

    def dynamics(a, u_, t_, dt, theta):
        f, A, Q = model.transition(a / x, np.asarray(u_) / u, t_ / t, dt / t, theta)
        return f * X, A * X[:, None] / z, Q * X[:, None] * X

    def measurement(a, u_, t_, theta):
        h, C, R = model.observation(a / x, np.asarray(u_) / u, t_ / t, theta)
        return h * y, C * y / z, R * y * y

    def initial(theta):
        start = model.start(theta)
        z1, P1 = start.linear(np.zeros((1, 1)))
        return Gaussian(start.density.mean * x, start.density.cov * x * x), z1[0] * z, P1 * z * z

    return replace(model, dynamics=dynamics, measurement=measurement, initial=initial)


@pytest.mark.long
@settings(max_examples=15, deadline=None, derandomize=True, phases=[Phase.generate])
@given(
    x=POWER, z=POWER, u=POWER, y=POWER, t=POWER, factor=st.sampled_from(["array", "if u", "math"])
)
def test_runs_and_verdicts_are_the_same_in_other_units(x, z, u, y, t, factor):
    model = user_model(factor)
    series = drawn(model, T=40)
    scaled = in_other_units(model, x, z, u, y, t)
    there = Series(series.y * y, series.u * u, dt=0.1 * t)
    a = np.random.default_rng(0).standard_normal((40, 3, 1))
    points = [Points(m, s, b) for m, s, b in ((model, series, a), (scaled, there, x * a))]
    record = model.record(model.theta())
    f, g = (p.transition(record)[0] for p in points)
    np.testing.assert_allclose(g / [x, z], f, rtol=1e-9)
    assert model.transitions.takes(*points[0].arguments(np.arange(39), True), record)
    assert model.transitions.recorded is (factor == "if u")
    runs = [engine.free_run(m, None, s) for m, s in ((model, series), (scaled, there))]
    np.testing.assert_allclose(runs[1].y / y, runs[0].y, rtol=1e-9)


@pytest.mark.parametrize("k", [-3, 3])
def test_estimates_are_the_same_in_other_units(k):
    """Between micro and mega; what is left of the units is in the kernels."""
    model = user_model("math")
    series = drawn(model, T=40)
    size = 10.0**k
    scaled = in_other_units(model, size, size, 1.0 / size, size, 1.0 / size)
    there = Series(series.y * size, series.u / size, dt=0.1 / size)
    pairs = ((model, series), (scaled, there))
    thetas = np.asarray(model.theta()) * np.array([[1.0, 1.0], [1.1, 0.9], [0.8, 1.2]])
    here, other = (moment_filter(m, thetas, s).log_likelihood for m, s in pairs)
    np.testing.assert_allclose(other + len(series) * np.log(size), here, atol=1e-3)
    options = {"n_particles": 10, "n_iterations": 2, "warm_start": False}
    estimates = [engine.rbps_em(m, s, **options) for m, s in pairs]
    np.testing.assert_allclose(estimates[1].theta, estimates[0].theta, rtol=1e-4)
    fits = [engine.fit_simulation(m, s, n_starts=2) for m, s in pairs]
    np.testing.assert_allclose(fits[1].rmse / size, fits[0].rmse, rtol=1e-4)


# ---- models that are refused ------------------------------------------------------------------------


USES = {
    "rbps_em": lambda m, s: engine.rbps_em(m, s, n_particles=5, n_iterations=1),
    "ps_em": lambda m, s: engine.ps_em(m, s, n_particles=5, n_iterations=1),
    "rbpf": lambda m, s: engine.rbpf(m, None, s, 5, np.random.default_rng(0)),
    "kalman": lambda m, s: engine.kalman_smoother(m, None, s),
    "quasi_ml": lambda m, s: quasi_ml(m, s),
    "diagnose": lambda m, s: engine.diagnose(m, s),
    "fit_simulation": lambda m, s: engine.fit_simulation(m, s),
    "free_run": lambda m, s: engine.free_run(m, None, s),
    "simulate": lambda m, s: engine.simulate(m, None, 60, np.random.default_rng(0), u=s.u, dt=0.1),
}
WRONG = {
    "negative": ([[1.0, 2.0], [2.0, 1.0]], "Q has the negative eigenvalue -1"),
    "asymmetric": ([[1.0, 0.5], [0.0, 1.0]], "Q is not symmetric"),
    "small": ([[1e10, 0.0], [0.0, -1e-18]], "Q has the negative eigenvalue -1e-18"),
    "small and asymmetric": ([[1e-18, 5e-19], [0.0, 1e-18]], "Q is not symmetric"),
    "not a number": ([[np.nan, 0.0], [0.0, 1.0]], "Q is not finite at the start values"),
    "shape": (np.eye(3), r"Q has shape \(3, 3\); \(2, 2\) or .* \(called at t = 0 with a"),
}


@pytest.mark.parametrize("use", USES)
@pytest.mark.parametrize("wrong", WRONG)
def test_a_covariance_that_is_none_is_refused_wherever_the_model_is_used(use, wrong):
    Q, message = WRONG[wrong]
    good = user_model()
    series = drawn(good)
    model = replace(good, dynamics=lambda *at: (*good.dynamics(*at)[:2], Q))
    with pytest.raises(ModelError, match=f"model 'a-users', dynamics: {message}"):
        USES[use](model, series)


def test_functions_are_checked_on_the_inputs_of_the_record():
    """1 / u is right for a record whose input is never zero, and refused for one where it is."""
    good = user_model()
    model = replace(
        good, measurement=lambda a, u, t, th: ([a[:, 0] + 1.0 / u[0]], [[0.5]], [[0.2]])
    )
    engine.rbpf(
        model, None, Series(np.zeros((20, 1)), np.ones((20, 2))), 5, np.random.default_rng(0)
    )
    with (
        np.errstate(divide="ignore"),
        pytest.raises(ModelError, match="measurement: h is not finite at the start values, t = 0"),
    ):
        engine.rbpf(
            model, None, Series(np.zeros((20, 1)), np.zeros((20, 2))), 5, np.random.default_rng(0)
        )


@pytest.mark.parametrize(
    ("initial", "message"),
    [
        (
            (Gaussian([0.0], [[-1.0]]), [0.0], [[1.0]]),
            r"cov of p\(a_1\) has the negative eigenvalue -1",
        ),
        ((Gaussian([0.0], [[1.0]]), [0.0], [[-1.0]]), "P1 has the negative eigenvalue -1"),
        ((Gaussian([0.0, 0.0], np.eye(2)), [0.0], [[1.0]]), r"p\(a_1\) draws shape \(3, 2\)"),
        (
            (Gaussian([0.0], [[1.0]]), lambda a: a[9], [[1.0]]),
            r"z1 or P1 as a function .* IndexError",
        ),
        (
            (Gaussian([0.0], [[1.0]]), [0.0]),
            "initial returned tuple of 2; the density of a_1, such",
        ),
        (None, "initial returned NoneType; the density"),
        ((([0.0], [[1.0]]), [0.0], [[1.0]]), "returned tuple of 2 as the density of a_1; the dens"),
    ],
)
def test_a_wrong_first_state_is_refused(initial, message):
    model = replace(user_model(), initial=lambda theta: initial)
    with pytest.raises(ModelError, match=message):
        engine.rbpf(model, None, drawn(user_model()), 5, np.random.default_rng(0))


def test_what_a_model_declares_is_checked_when_it_is_made():
    good = user_model()
    for parameters, message in (
        (
            [Parameter("w", 1.0, "", (2, 0))],
            r"parameter 'w': bounds \(2, 0\) are not \(low, high\)",
        ),
        ([Parameter("w", 3.0, "", (0, 2))], "default 3 is outside its bounds"),
        ([Parameter("w", 1.0), Parameter("w", 1.0)], "two parameters named 'w'"),
    ):
        with pytest.raises(ModelError, match=message):
            replace(good, parameters=parameters)
        with pytest.raises(ModelError, match=message):
            replace(engine.as_general(good), parameters=parameters)


def test_writing_into_the_inputs_is_refused_with_the_remedy():
    good = user_model()

    def dynamics(a, u, t, dt, theta):
        u *= 2.0
        return good.dynamics(a, u, t, dt, theta)

    with pytest.raises(ModelError, match="must not write into what it is given: copy it first"):
        engine.rbpf(
            replace(good, dynamics=dynamics), None, drawn(good), 5, np.random.default_rng(0)
        )


# ---- inputs that differ from row to row, step after step, as where an effect changes them -------------------


def driven(factor, calls):
    def dynamics(a, u, t, dt, theta):
        calls.append(len(a))
        return [0.9 * a[:, 0] + factor(u) * u[0]], np.zeros((1, 0)), [[0.1]]

    return MixedModel(
        name="driven", dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[0.1]]),
        initial=lambda theta: (Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))),
        nonlinear={"x": "1"}, inputs={"u": "1"}, outputs={"y": "1"}, parameters=[],
    )  # fmt: skip


@pytest.mark.parametrize(
    "factor",
    [
        lambda u: 2.0 if np.any(u[0] > 3.0) else 1.0,  # beyond a level that is reached late
        lambda u: 1.0 + np.ptp(np.atleast_1d(u[0])),  # by how far the rows differ
        lambda u: 1.0 + np.mean(u[0]) if np.max(u[0]) < -3.0 else 1.0,
    ],
)
def test_inputs_that_go_further_than_before_are_looked_at(factor):
    model, rng = driven(factor, []), np.random.default_rng(0)
    a, record = rng.normal(size=(20, 1)), model.record(model.theta())
    for k in range(200):
        u = np.full(20, np.sin(0.3 * k))
        if k == 40:
            u = u + 0.5 * rng.random(20)
        if k == 120:
            u = 10.0 * rng.normal(size=20)
        f, _, _ = model.transition(a, u[None], float(k), 1.0, record)
        alone = [
            model.transition(a[i : i + 1], u[i : i + 1], float(k), 1.0, record)[0][0, 0]
            for i in range(20)
        ]
        np.testing.assert_allclose(f[:, 0], alone, rtol=1e-12)


def test_inputs_within_those_of_before_are_not_looked_at_each_time():
    calls = []
    model, rng = driven(lambda u: 1.0, calls), np.random.default_rng(0)
    a, record = rng.normal(size=(20, 1)), model.record(model.theta())
    for k in range(1000):
        model.transition(a, rng.uniform(-1.0, 1.0, (1, 20)), float(k), 1.0, record)
    assert len(calls) < 1500


# ---- functions that are none: what they return depends on more than their arguments -------------------------


def unrepeatable(where):
    """The user's model with noise drawn in a function, or with a memory of its calls."""
    good, rng, last = user_model(), np.random.default_rng(0), [0.0]

    def remembered(x):
        last[0] = 0.9 * last[0] + 0.1
        return x + last[0]

    change = remembered if where == "memory" else lambda x: x + 0.1 * rng.standard_normal()

    def dynamics(a, u, t, dt, theta):
        f, A, Q = good.dynamics(a, u, t, dt, theta)
        return [change(f[0]), f[1]], A, Q

    def measurement(a, u, t, theta):
        h, C, R = good.measurement(a, u, t, theta)
        return [change(h[0])], C, R

    def initial(theta):
        density, z, P = good.initial(theta)
        return density, change(np.asarray(z)), P

    if where == "measurement":
        return replace(good, measurement=measurement)
    return (
        replace(good, initial=initial) if where == "initial" else replace(good, dynamics=dynamics)
    )


@pytest.mark.parametrize("use", USES)
@pytest.mark.parametrize("where", ["dynamics", "memory", "measurement", "initial"])
def test_a_function_that_draws_or_remembers_is_refused(where, use):
    model = unrepeatable(where)
    name = "dynamics" if where == "memory" else where
    with pytest.raises(ModelError, match=f"{name}: called again with the same arg.*Q, R or P1"):
        USES[use](model, drawn(user_model()))


def test_one_parameter_vector_a_call_is_grouped_once_for_all_steps(monkeypatch):
    """Not at every step anew, also where one of the vectors has no value."""

    def dynamics(a, u, t, dt, theta):
        return [math.sqrt(theta.w) * a[:, 0]], np.zeros((1, 0)), [[0.1]]

    model = MixedModel(
        name="rooted",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[0.1]]),
        initial=lambda theta: (Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))),
        nonlinear={"x": "1"},
        outputs={"y": "1"},
        parameters=[Parameter("w", 0.5, "1")],
    )
    series = Series(y=np.sin(np.arange(40.0)), dt=1.0)
    groups, made = Rows.groups, []
    monkeypatch.setattr(Rows, "groups", lambda *args: made.append(1) or groups(*args))
    found = moment_filter(model, [[0.5], [-1.0], [0.7]], series)
    assert np.isfinite(found.log_likelihood).tolist() == [True, False, True]
    assert len(made) < 10


def test_values_of_a_model_with_the_same_parameters_in_another_order_go_by_name():
    model = user_model()
    other = replace(model, parameters=model.parameters[::-1])
    theta = model.theta([0.31, *np.asarray(model.theta())[1:]])
    assert other.theta(theta).asdict() == theta.asdict()
    assert (
        np.asarray(other.theta(np.asarray(theta)[::-1])).tolist()
        == np.asarray(theta)[::-1].tolist()
    )
