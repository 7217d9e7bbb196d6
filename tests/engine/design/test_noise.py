"""What a rival's noise explains, and when a screen raises an alarm, against what defines them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from engine.design.alarm import Alarm, _edges
from engine.design.candidates import before_any
from engine.design.contest import Demand, contest, demand_of
from engine.design.noise import NoiseRoom, noise_room
from engine.design.residuals import Residuals
from engine.design.runs import Experiments, linearised
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits.calibration import SERIES
from engine.diagnose.screening.screen import CLEARLY_HEAVIER
from engine.diagnose.screening.screening import screen_effects
from engine.distributions import chi2_sf
from engine.estimation.quasi_ml import quasi_ml
from engine.simulation.simulate import simulate
from tests.engine.design.models_for_design import CAUSES, drive

WHITE = NoiseRoom(np.eye(80), np.ones((1, 80)), np.ones(1, dtype=bool))


def test_one_scale_common_to_all_readings_explains_a_logarithm():
    N, x = 80, np.linspace(0.0, 9.0, 50)
    rng, adapts = np.random.default_rng(0), np.random.default_rng(1).standard_normal((N, 5))
    v = np.full(N, 0.7)
    v -= adapts @ np.linalg.lstsq(adapts, v, rcond=None)[0]
    drawn = Residuals.drawn(WHITE, v, adapts, np.zeros((0, 5)), rng)
    white = np.ones(drawn.noise.power.shape)
    rest = drawn._left(drawn.noise, white)[0].sum(axis=1)
    alone = rest[np.arange(50) % len(rest)]
    np.testing.assert_allclose(drawn.lost(x), N * np.log1p(x**2 / alone), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(
        drawn.scores(x, rng).statistic, N * x**2 / (alone + x**2), rtol=1e-6, atol=1e-9
    )
    assert rest.mean() == pytest.approx(N - 5 - 1, abs=3.0)  # chi2 of the rest


def test_noise_that_is_not_estimated_explains_nothing():
    known = NoiseRoom(np.eye(30), np.zeros((0, 30)), np.zeros(0, dtype=bool))
    rng = np.random.default_rng(0)
    assert Residuals.drawn(known, np.ones(30), np.ones((30, 1)), np.ones((1, 1)), rng) is None


def test_the_spectrum_gives_what_whole_matrices_give():
    q = before_any(drive(), CAUSES, None, 0.1, None)
    u = np.repeat(np.random.default_rng(3).uniform(-6, 6, (1, 10, 1)), 10, axis=1)
    e, seen, base = Experiments.of(u, 0.1, "zoh", 1), np.ones((100, 1), dtype=bool), q.base
    runs = linearised(base.model, base.theta, e, base.indices)
    room = noise_room(base, base.theta, runs, e, seen)
    assert len(room.shares) == 2
    together = np.sort(room.shares.sum(axis=0))
    np.testing.assert_allclose(together[2:], 1.0, atol=1e-2)  # the first state has the rest
    one = NoiseRoom(room.basis, room.shares[:1], room.there[:1])
    for N in (100, 60):
        A = ((room.basis * room.shares[0]) @ room.basis.T)[:N, :N]
        np.testing.assert_allclose(
            (one.of(N).basis * one.of(N).shares) @ one.of(N).basis.T, A, atol=1e-9
        )
        v = np.sin(np.arange(N) / 4.0)
        drawn = Residuals.drawn(one, v, np.ones((N, 1)), np.zeros((0, 1)), np.random.default_rng(4))
        left = np.random.default_rng(4).standard_normal((len(drawn.noise.power), N))
        unit = v / np.linalg.norm(v)
        left -= np.outer(left @ unit, unit)

        def f(log_w, r, A=A, N=N):
            C = np.eye(N) + (np.exp(log_w) - 1.0) * A
            inverse, ones = np.linalg.inv(C), np.ones(N)
            follows = (ones @ inverse @ r) ** 2 / (ones @ inverse @ ones)
            return np.linalg.slogdet(C)[1] + r @ inverse @ r - follows

        x, near = np.array([2.0, 4.0, 8.0]), []
        for k in range(3):
            loud, quiet = (
                minimize_scalar(f, (0.0, 0.5), args=(left[k] + size * unit,)).fun
                for size in (x[k], 0.0)
            )
            near.append(loud - quiet)
        np.testing.assert_allclose(drawn.lost(x), near, rtol=0.05, atol=0.1)


def _room(**drive_is):
    q = before_any(drive(**drive_is), CAUSES, None, 0.1, None)
    u = np.repeat(np.random.default_rng(3).uniform(-6, 6, (1, 8, 1)), 10, axis=1)
    e, seen = Experiments.of(u, 0.1, "zoh", 1), np.ones((80, 1), dtype=bool)
    runs = linearised(q.base.model, q.base.theta, e, q.base.indices)
    return noise_room(q.base, q.base.theta, runs, e, seen)


def _matrices(room):
    return np.array([(room.basis * share) @ room.basis.T for share in room.shares])


@pytest.mark.parametrize("noise", ["variance", "logarithm"])
def test_it_does_not_matter_what_a_parameter_is_of_a_noise(noise):
    as_it_is, otherwise = _room(), _room(noise=noise)
    assert otherwise.there.all()
    np.testing.assert_allclose(_matrices(otherwise), _matrices(as_it_is), atol=0.02)


def test_noise_that_was_estimated_at_zero_may_grow():
    room = _room(q=0.0)
    assert room.there.tolist() == [False, True]
    grows, is_there = room.shares
    np.testing.assert_allclose(is_there[1:], 1.0, atol=0.02)
    assert grows.mean() == pytest.approx(1.0)
    v = room.basis @ np.sqrt(grows)  # what the noise would be
    v, other = v / np.linalg.norm(v), room.basis[:, np.argmin(grows)]
    known = NoiseRoom(room.basis, room.shares[1:], room.there[1:])
    for direction, less in ((v, True), (other, False)):
        with_it, without = (
            Residuals.drawn(
                r, direction, np.zeros((80, 0)), np.zeros((0, 0)), np.random.default_rng(1)
            )
            .lost(np.full(200, 6.0))
            .mean()
            for r in (room, known)
        )
        assert bool(with_it < 0.9 * without) is less


def test_a_first_reading_without_noise_tells_of_none():
    """Nothing scatters there: neither the first state nor the sensor."""
    room = _room(r=0.0, first=0.0)
    assert np.isfinite(room.shares).all()
    assert len(room.basis) == 79
    np.testing.assert_allclose(room.shares[room.there].sum(axis=0), 1.0, atol=0.02)


def test_noise_that_the_mean_adapted_to_is_estimated_low_and_makes_tests_bold():
    """As with process noise, of which the slowest part is what a force or a gain would be, too."""
    rng = np.random.default_rng(6)
    slow = np.cos(np.pi * np.outer(np.arange(60) + 0.5, np.arange(60)) / 60.0)
    basis = slow / np.linalg.norm(slow, axis=0)
    strong = np.where(np.arange(60) < 6, 0.9, 0.0)
    room = NoiseRoom(basis, np.array([strong, 1.0 - strong]), np.ones(2, dtype=bool))
    v = basis[:, 4] + 0.3 * basis[:, 5]
    free, adapts, held = (
        Residuals.drawn(room, v, basis[:, :p], h * np.eye(p), rng)
        for p, h in ((0, 0.0), (3, 1e-3), (3, 1e3))
    )
    spectrum = 1.0 + (9.0 - 1.0) * free.shares[0]
    plain, bold, known = (
        r.simulated(np.tile(spectrum, (3000, 1)), rng).mean() for r in (free, adapts, held)
    )
    assert plain == pytest.approx(1.2, abs=0.15)  # what it has in common with the noise by chance
    assert bold > 1.15 * plain
    assert known == pytest.approx(plain, abs=0.15)  # an earlier record leaves nothing to adapt to


@pytest.mark.slow
def test_statistics_that_are_drawn_are_those_of_a_screen():
    """Also what noise parameters have in common with the effect, by chance, which a screen takes out of it."""
    N, model, u = 60, drive(), np.repeat(np.random.default_rng(5).uniform(-6, 6, (1, 12, 1)), 5, 1)
    q = before_any(model, CAUSES, None, 0.1, None)
    own = contest(
        0, q.candidates, q.base, Experiments.of(u, 0.1, "zoh", 1), np.ones((N, 1), bool), True, {}
    )
    left, rng = own.at(N)[1], np.random.default_rng(0)
    size = np.sqrt(own.distance(N)[-1]) + rng.standard_normal(400)
    drawn = own.residuals(len(left) - 1, N, left[-1], rng).scores(size, rng).statistic
    true, said = q.candidates[0], []
    for k in range(24):
        rng = np.random.default_rng([1, k])
        series = simulate(true.model, true.theta, N, rng, u=u[0], dt=0.1).series
        fit = quasi_ml(model, series, None, None)
        setting = setting_for(model, series, np.asarray(fit.theta))
        seen = screen_effects(fit, series, setting, ["drag"], 0.05, 0, lambda stage, share: None)
        said.append(seen.scores[0].statistic)
    assert np.mean(drawn) == pytest.approx(np.mean(said), rel=0.25)  # a third less without that


def _of_chi2(times: float = 1.0) -> np.ndarray:
    return times * np.random.default_rng(8).chisquare(1, size=(20, SERIES))


def raised(statistic: np.ndarray, v: np.ndarray, simulated: np.ndarray) -> np.ndarray:
    return Alarm(5.0).raised(statistic, v, np.zeros(len(statistic)), simulated, 0)


def test_an_alarm_needs_more_where_simulated_records_are_bold():
    statistic, v = np.linspace(0.0, 30.0, 600), np.ones(100)
    calm, bold = (raised(statistic, v, _of_chi2(s)) for s in (1.0, 2.5))
    assert not calm[statistic < 4.0].any()  # multiplier draws of a record may be lighter than chi2
    assert calm[statistic > 20.0].all()
    assert bold.sum() < calm.sum()
    assert bold[-1]  # so clear that nothing is simulated


def test_an_alarm_needs_more_where_few_readings_show_the_effect():
    """As the multiplier draws of a screen do it, which keep the size of every reading's score."""
    rng = np.random.default_rng(2)
    statistic = np.linspace(0.0, 60.0, 600)
    few = np.concatenate([np.full(4, 5.0), np.full(296, 0.02)])
    spread, single = (raised(statistic, v, _of_chi2()) for v in (np.ones(300), few))
    assert single.sum() < spread.sum()
    for v, shared in ((np.ones(300), 0.0), (few, 0.0), (few, 0.6)):
        there, apart, rng = [], [], np.random.default_rng(3)
        for _ in range(100):
            d = rng.standard_normal(300)
            d -= v * (v @ d) / (v @ v)
            u = np.sqrt(1.0 - shared) * v / np.linalg.norm(v)
            u -= np.sqrt(shared) * d / np.linalg.norm(d)  # beside noise parameters
            e = rng.standard_normal(300)
            s = u * (e + (np.sqrt(15.0) - u @ e) * u)
            signs = rng.choice([-1.0, 1.0], size=(499, 300))
            points = np.quantile((signs @ s) ** 2, [0.95, 0.99])
            there.append(0.05 / chi2_sf(float(points[0]), 1))
            apart.append(points[1] - points[0])
        edge, further, _ = _edges(np.full(100, 15.0), v, np.full(100, shared), rng)
        told = 0.05 / chi2_sf(edge, 1)
        assert np.median(further - edge) == pytest.approx(np.median(apart), rel=0.35, abs=0.5)
        middle = np.log(np.median(there))
        assert np.log(np.median(told)) == pytest.approx(middle, abs=0.1 + 0.25 * middle)
        heavy = float(np.mean(np.array(there) > CLEARLY_HEAVIER))
        assert np.mean(told > CLEARLY_HEAVIER) == pytest.approx(heavy, abs=0.2)


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


@pytest.mark.long
def test_the_probability_falls_as_the_alarm_needs_more():
    q = before_any(drive(), CAUSES, None, 0.1, None)
    u = np.repeat(np.random.default_rng(5).uniform(-6, 6, (1, 12, 1)), 10, axis=1)
    e, seen = Experiments.of(u, 0.1, "zoh", 1), np.ones((120, 1), dtype=bool)
    own = contest(0, q.candidates, q.base, e, seen, True, {})
    demand = Demand(np.array([-np.inf]), np.zeros(1), np.zeros(1, dtype=bool))
    p = [own.probability(60, demand, Alarm(t), 0) for t in (1.0, 5.0, 12.0, 30.0)]
    assert np.all(np.diff(p) <= 0.0)
    assert p[0] > p[-1]
    known = NoiseRoom(np.eye(40), np.zeros((0, 40)), np.zeros(0, dtype=bool))
    sure = replace(own, rivals=tuple(replace(one, noise=known) for one in own.rivals))
    assert sure.probability(40, demand, Alarm(5.0), 0) > own.probability(40, demand, Alarm(5.0), 0)
