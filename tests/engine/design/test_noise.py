"""What a rival's noise explains, and when a screen raises an alarm, against what defines them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from engine.design.alarm import Alarm, _heavier, logs
from engine.design.candidates import before_any
from engine.design.criterion import Demand, contest, demand_of
from engine.design.noise import NoiseRoom, noise_room
from engine.design.runs import Experiments, linearised
from engine.distributions import chi2_sf
from tests.engine.design.models_for_design import CAUSES, drive


def test_one_scale_common_to_all_readings_explains_a_logarithm():
    N, p = 80, 5.0
    room = NoiseRoom(np.eye(80), np.ones((1, 80)))
    X, lost, statistic = room.left(np.full(N, 0.7), p)
    np.testing.assert_allclose(lost, N * np.log1p(X / (N - p)), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(statistic, N * X / (N - p + X), rtol=1e-6)


def test_noise_that_is_not_estimated_explains_nothing():
    X, lost, statistic = NoiseRoom(np.eye(30), np.zeros((0, 30))).left(np.ones(30), 2.0)
    np.testing.assert_array_equal(lost, X)
    np.testing.assert_array_equal(statistic, X)


def test_the_spectrum_gives_what_whole_matrices_give():
    q = before_any(drive(), CAUSES, None, 0.1, None)
    u = np.repeat(np.random.default_rng(3).uniform(-6, 6, (1, 10, 1)), 10, axis=1)
    e, seen, base = Experiments.of(u, 0.1, "zoh", 1), np.ones((100, 1), dtype=bool), q.base
    runs = linearised(base.model, base.theta, e, base.indices)
    room = noise_room(base, base.theta, runs, e, seen)
    assert len(room.shares) == 2
    together = np.sort(room.shares.sum(axis=0))
    np.testing.assert_allclose(together[2:], 1.0, atol=1e-2)  # the first state has the rest
    one = NoiseRoom(room.basis, room.shares[:1])
    v = np.sin(np.arange(100) / 4.0)
    A = (room.basis * room.shares[0]) @ room.basis.T

    def f(log_w, x):
        C = np.eye(100) + (np.exp(log_w) - 1.0) * A
        inverse = np.linalg.inv(C)
        return np.linalg.slogdet(C)[1] + np.trace(inverse) * 0.97 + x * (v @ inverse @ v) / (v @ v)

    X, lost, _ = one.left(v, 3.0)
    for k in (4, 9, 14):
        best = minimize_scalar(f, (0.0, 1.0), args=(X[k],)).fun
        none = minimize_scalar(f, (-0.1, 0.1), args=(0.0,)).fun
        assert lost[k] == pytest.approx(best - none, rel=1e-3, abs=1e-3)


def test_an_alarm_needs_more_where_few_readings_make_p_values_bold():
    statistic = np.linspace(0.0, 30.0, 600)
    bold, calm = (Alarm(5.0).raised(statistic, np.ones(N), 8.0, 0) for N in (24, 2400))
    assert not calm[statistic < 5.0].any()
    assert calm[statistic > 20.0].all()
    assert bold.sum() < calm.sum()
    assert bold[-1]  # so clear that nothing is simulated


def test_an_alarm_needs_more_where_few_readings_show_the_effect():
    """As the multiplier draws of a screen do it, which keep the size of every reading's score."""
    rng = np.random.default_rng(2)
    statistic = np.linspace(0.0, 60.0, 600)
    few = np.concatenate([np.full(4, 5.0), np.full(296, 0.02)])
    spread, single = (Alarm(5.0).raised(statistic, v, 3.0, 0) for v in (np.ones(300), few))
    assert single.sum() < spread.sum()
    for v, heavy in ((np.ones(300), False), (few, True)):
        v = v * np.sqrt(15.0) / np.linalg.norm(v)
        drawn = []
        for _ in range(40):
            s = v * (v + rng.standard_normal(300))
            signs = rng.choice([-1.0, 1.0], size=(499, 300))
            drawn.append(np.quantile((signs @ s) ** 2 / (v @ v), 0.95))
        told = float(_heavier(np.array([15.0]), v)[0])
        there = 0.05 / chi2_sf(float(np.median(drawn)), 1)
        assert (told > 2.5) is heavy
        assert np.log(told) == pytest.approx(np.log(there), abs=np.log(4.0))


def test_of_causes_that_say_the_same_the_plainer_is_named():
    demand = Demand(np.array([2.0]), np.array([0.0]), np.array([True]))
    gained, between = (
        np.array([[0.1], [0.1], [-1.0], [3.0]]),
        np.array([[0.2], [4.0], [0.2], [4.0]]),
    )
    assert demand.met(gained, between)[:, 0].tolist() == [True, False, False, True]
    other = replace(demand, plainer=np.array([False]))
    assert other.met(gained, between)[:, 0].tolist() == [False, False, False, True]
    assert demand.but([True]).met(gained - 50.0, between).all()


def test_a_constant_force_is_plainer_than_a_friction_that_predicts_the_same():
    """And a wider kind must itself be ahead of the plainer one that it contains."""
    q = before_any(
        drive(),
        {"force:velocity": 0.1, "linear:velocity": 0.1, "pole:velocity": 0.1},
        None,
        0.1,
        None,
    )
    force, linear, pole = (demand_of(i, q.candidates, 100, True) for i in range(3))
    assert force.plainer.tolist() == [True, True]
    assert linear.plainer.tolist()[0] is False
    assert pole.plainer.tolist() == [False, False]
    assert linear.lead.tolist() == [2.0, -2.0]  # a pole contains it
    assert pole.lead.tolist() == [2.0, 2.0]


def test_p_values_of_few_readings_are_bolder_than_those_of_many():
    rng = np.random.default_rng(1)
    a = rng.standard_normal((20000, 20))
    share = a[:, 0] ** 2 / (a**2).sum(axis=1)
    there = -np.log(chi2_sf(24.0 * share, 1)).mean()
    assert logs(24, 4) == pytest.approx(there, abs=0.05)
    assert logs(24, 4) > logs(100, 4) > logs(10000, 4) > 0.999


def test_the_probability_falls_as_the_alarm_needs_more():
    q = before_any(drive(), CAUSES, None, 0.1, None)
    u = np.repeat(np.random.default_rng(5).uniform(-6, 6, (1, 12, 1)), 10, axis=1)
    e, seen = Experiments.of(u, 0.1, "zoh", 1), np.ones((120, 1), dtype=bool)
    own = contest(0, q.candidates, q.base, e, seen, True, {})
    demand = Demand(np.array([-np.inf]), np.zeros(1), np.zeros(1, dtype=bool))
    p = [own.probability(60, demand, Alarm(t), 0) for t in (1.0, 5.0, 12.0, 30.0)]
    assert np.all(np.diff(p) <= 0.0)
    assert p[0] > p[-1]
