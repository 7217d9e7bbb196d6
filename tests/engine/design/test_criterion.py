"""D against what defines it: covariances written out, likelihood ratios of simulated records, units, length."""

import numpy as np
import pytest

from engine.data.series import Series
from engine.design.bounds import Bounds
from engine.design.candidates import before_any
from engine.design.contest import contest
from engine.design.criterion import adapted, linear_distances, precision, whiten
from engine.design.runs import Experiments, linearised, simulated
from engine.design.search import Search, Task
from engine.errors import OptionError
from engine.filters.kalman import kalman_smoother
from engine.filters.sigma_point import moment_filter
from engine.models.registry import get_model
from engine.simulation.simulate import simulate
from engine.statespace.model import Gaussian, MixedModel, Parameter
from tests.engine.design.models_for_design import BOUNDS, CAUSES, drive


def linear(gain=1.0):
    """A linear second-order system with noise in both states; the gain of its input is all that differs."""
    A = np.array([[1.0, 0.1], [-0.2, 0.9]])

    def dynamics(a, u, t, dt, th):
        return np.array([0.0, 0.1 * th.g * u[0]]), A, np.diag([1e-4, 4e-3])

    return MixedModel(
        name="two",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: (np.zeros(1), [[1.0, 0.0]], [[0.01]]),
        initial=lambda th: (Gaussian([], np.zeros((0, 0))), [0.1, 0.0], np.diag([0.04, 0.01])),
        linear={"x": "m", "v": "m/s"},
        inputs={"u": "N"},
        outputs={"y": "m"},
        parameters=[Parameter("g", gain, "1", (-10.0, 10.0))],
    )


def _u(T, seed=0):
    return np.random.default_rng(seed).standard_normal((1, T, 1)).cumsum(axis=1) * 0.3


def test_whitening_is_the_inverse_of_the_whole_covariance():
    T = 25
    model, e = linear(), Experiments.of(_u(T), 0.1, "zoh", 1)
    seen = np.ones((T, 1), dtype=bool)
    seen[7] = False
    runs = linearised(model, np.array([1.0]), e, [0])
    change = np.random.default_rng(1).standard_normal((1, T, 1, 2))
    W = whiten(runs, change, seen)[0, :, 0]
    A, Q, H = runs.J[0, 0], runs.Q[0, 0], runs.H[0, 0]
    S, P = np.zeros((T, T)), np.diag([0.04, 0.01])
    for t in range(T):
        Phi = np.eye(2)
        for s in range(t, T):
            S[s, t] = S[t, s] = (H @ Phi @ P @ H.T)[0, 0]
            Phi = A @ Phi
        P = A @ P @ A.T + Q
    S += 0.01 * np.eye(T)
    d = np.delete(change[0, :, 0], 7, axis=0)
    S = np.delete(np.delete(S, 7, axis=0), 7, axis=1)
    np.testing.assert_allclose(W.T @ W, d.T @ np.linalg.solve(S, d), rtol=1e-9)
    assert (W[7] == 0.0).all()


@pytest.mark.slow
def test_d_is_the_mean_of_twice_the_log_likelihood_ratio_and_its_variance_is_four_times_that():
    """Simulated records of one linear model, both models' exact likelihoods."""
    T, n = 60, 400
    u = _u(T, 2)
    one, other = linear(1.0), linear(2.2)
    e, seen = Experiments.of(u, 0.1, "zoh", 1), np.ones((T, 1), dtype=bool)
    runs = linearised(other, np.array([2.2]), e, [])
    y, _ = simulated(one, np.array([1.0]), e)
    D = float((whiten(runs, (y - runs.y)[..., None], seen) ** 2).sum())
    rng, ratios = np.random.default_rng(3), []
    for _ in range(n):
        s = simulate(one, None, T, rng, u=u[0], dt=0.1).series
        a, b = (
            moment_filter(m, np.asarray(m.theta())[None], s).log_likelihood[0] for m in (one, other)
        )
        ratios.append(2.0 * (a - b))
    assert kalman_smoother(one, None, s).log_likelihood == pytest.approx(a)
    assert 3.0 < D < 60.0
    assert np.mean(ratios) == pytest.approx(D, abs=4.0 * np.sqrt(4.0 * D / n))
    assert np.var(ratios) == pytest.approx(4.0 * D, rel=4.0 * np.sqrt(2.0 / n))


def _D(model, causes, u, dt):
    q = before_any(model, causes, None, dt, None)
    e = Experiments.of(u, dt, "zoh", 1)
    seen = np.ones((u.shape[1], 1), dtype=bool)
    out = []
    for i, j in ((0, 1), (1, 0)):
        true, rival = q.candidates[i], q.candidates[j]
        y, _ = simulated(true.model, true.theta, e)
        out.append(adapted(y, rival, precision(rival, True), e, seen)[2])
    return out


def test_d_does_not_depend_on_units():
    u = np.repeat(np.random.default_rng(4).uniform(-6, 6, (1, 15, 1)), 10, axis=1)
    si = _D(drive(), CAUSES, u, 0.1)
    mm, mv, minute = 1000.0, 1000.0, 1.0 / 60.0
    other = {"drag:velocity": 0.25 / mm, "coulomb:velocity": 0.5 * mm / minute**2}
    there = _D(drive(mm, mv, minute), other, mv * u, 0.1 * minute)
    assert min(si) > 1.0
    np.testing.assert_allclose(there, si, rtol=1e-3)


def test_d_grows_with_length_and_prefixes_are_those_of_shorter_inputs():
    T = 200
    u = np.repeat(np.random.default_rng(5).uniform(-6, 6, (1, 20, 1)), 10, axis=1)
    q = before_any(drive(), CAUSES, None, 0.1, None)
    e, seen = Experiments.of(u, 0.1, "zoh", 1), np.ones((T, 1), dtype=bool)
    one = contest(0, q.candidates, q.base, e, seen, True, {})
    values = np.array([one.distance(n) for n in (40, 80, 120, 160, 200)])
    assert (np.diff(values, axis=0) >= -1e-9).all()
    short = Experiments.of(u[:, :120], 0.1, "zoh", 1)
    there = contest(0, q.candidates, q.base, short, seen[:120], True, {}).distance(120)
    np.testing.assert_allclose(there, values[2], rtol=0.1)


def test_causes_that_are_the_same_have_no_distance():
    u = np.repeat(np.random.default_rng(6).uniform(-6, 6, (1, 15, 1)), 10, axis=1)
    twins = {"force:velocity": 0.2, "input-offset:voltage": 0.4}
    assert max(_D(drive(), twins, u, 0.1)) < 1e-6
    assert min(_D(drive(), CAUSES, u, 0.1)) > 1.0


def test_what_an_earlier_record_told_keeps_a_rival_from_adapting():
    u = np.repeat(np.random.default_rng(7).uniform(-6, 6, (1, 15, 1)), 10, axis=1)
    q = before_any(drive(), CAUSES, None, 0.1, None)
    e, seen = Experiments.of(u, 0.1, "zoh", 1), np.ones((150, 1), dtype=bool)
    true, rival = q.candidates
    y, _ = simulated(true.model, true.theta, e)
    free = adapted(y, rival, precision(rival, True), e, seen)[2]
    held = adapted(y, rival, 1e12 * np.eye(len(rival.free)), e, seen)[2]
    runs = linearised(rival.model, rival.theta, e, [])
    as_it_is = float((whiten(runs, (y - runs.y)[..., None], seen) ** 2).sum())
    assert free < 0.9 * held
    assert held == pytest.approx(as_it_is, rel=1e-3)


def test_derivatives_of_runs_are_those_of_differences():
    model, e = get_model("oscillator"), Experiments.of(_u(80, 8), 0.05, "zoh", 2)
    theta = np.asarray(model.theta())
    runs = linearised(model, theta, e, [0, 1, 2])
    for k in range(3):
        h = 1e-5 * theta[k]
        up, down = theta.copy(), theta.copy()
        up[k] += h
        down[k] -= h
        slope = (simulated(model, up, e)[0] - simulated(model, down, e)[0]) / (2 * h)
        np.testing.assert_allclose(
            runs.dy[..., k], slope, rtol=1e-4, atol=1e-6 * np.abs(slope).max()
        )
    assert len(e.t) == 159
    series = Series(np.full((80, 1), np.nan), e.u[0, ::2], dt=0.05).refined(2)
    assert np.array_equal(series.samples, e.rows)


def test_many_inputs_side_by_side_give_what_each_gives_alone():
    q = before_any(drive(), CAUSES, None, 0.1, None)
    c = q.candidates[1]
    u = np.random.default_rng(9).uniform(-6, 6, (5, 60, 1))
    together = linearised(c.model, c.theta, Experiments.of(u, 0.1, "zoh", 1), c.indices)
    for k in range(5):
        alone = linearised(c.model, c.theta, Experiments.of(u[k : k + 1], 0.1, "zoh", 1), c.indices)
        for name in ("y", "x", "J", "H", "dy"):
            np.testing.assert_allclose(
                getattr(together, name)[k], getattr(alone, name)[0], rtol=1e-7, atol=1e-9
            )


def test_linear_distances_agree_with_the_adapted_rival_near_its_own_point():
    q = before_any(drive(), CAUSES, None, 0.1, None)
    task = Task(q.candidates, Bounds.of(BOUNDS), 150, 0.1, "zoh", 1, np.ones(1, dtype=bool), True)
    state = Search(task, np.random.default_rng(10))
    best = state.refined(max(state.starts(16, lambda share: None), key=state.worth))
    e = task.experiments(best.u[None])
    for i, j in state.ordered():
        rival = q.candidates[j]
        y, _ = simulated(q.candidates[i].model, q.candidates[i].theta, e)
        runs = linearised(rival.model, best.points[i, j], e, rival.indices)
        away = (best.points[i, j] - rival.theta)[rival.indices]
        linear_ = linear_distances(y, runs, state.precisions[j], away, task.measured(e))[0]
        assert linear_ == pytest.approx(best.D[i, j], rel=0.05, abs=0.05)


def test_an_input_that_drives_a_cause_beyond_all_numbers_is_not_weighed():
    q = before_any(drive(), CAUSES, None, 0.1, None)
    seen = np.ones((60, 1), dtype=bool)
    task = Task(q.candidates, Bounds.of(BOUNDS), 60, 0.1, "zoh", 1, np.ones(1, dtype=bool), True)
    state = Search(task, np.random.default_rng(11))
    e = task.experiments(np.random.default_rng(12).uniform(-6, 6, (2, 60, 1)))
    rival = q.candidates[1]
    runs = linearised(rival.model, rival.theta, e, rival.indices)
    truth = runs.y + np.array([0.1, 1e200])[:, None, None]
    away = np.zeros(len(rival.indices))
    D = linear_distances(truth, runs, state.precisions[1], away, seen)
    assert D[0] > 0.0
    assert np.isnan(D[1])
    theta, _, _ = adapted(truth[1:], rival, state.precisions[1], task.experiments(e.u[1:]), seen)
    assert np.array_equal(theta, rival.theta)


def test_what_a_record_told_of_a_cause_is_kept():
    told = {"free": ["k", "drag_velocity"], "matrix": [[4.0, 1.0], [1.0, 9.0]]}
    causes = {**CAUSES, "drag:velocity": {"drag_velocity": 0.2, "information": told}}
    found = before_any(drive(), causes, None, 0.1, None).candidates[0]
    there = [found.free.index(name) for name in told["free"]]
    np.testing.assert_allclose(found.information[np.ix_(there, there)], told["matrix"])
    assert np.count_nonzero(found.information) == 4
    np.testing.assert_allclose(
        found.covariance[np.ix_(there, there)], np.linalg.inv(told["matrix"])
    )


@pytest.mark.parametrize(
    ("information", "field"),
    [
        ({"free": ["k"]}, "information"),
        ({"free": ["k"], "matrix": [[1.0, 2.0]]}, "information.matrix"),
        ({"free": ["k", "k"], "matrix": [[1.0, 0.0], [0.0, 1.0]]}, "information.matrix"),
        ({"free": ["k", "b"], "matrix": [[1.0, 0.5], [0.0, 1.0]]}, "information.matrix"),
        ({"free": ["k"], "matrix": [[None]]}, "information.matrix"),
    ],
)
def test_information_that_is_none_is_refused(information, field):
    causes = {**CAUSES, "drag:velocity": {"drag_velocity": 0.2, "information": information}}
    with pytest.raises(OptionError) as refused:
        before_any(drive(), causes, None, 0.1, None)
    assert refused.value.field == f"causes.drag:velocity.{field}"
