"""Many records whose first states scatter by less, or more, than the model says."""

import numpy as np
import pytest

import engine
from engine.data.joined import in_turn, together
from engine.diagnose import all_effects
from engine.diagnose.effects.of_series import setting_for
from engine.estimation.quasi_ml import quasi_ml
from engine.filters.sigma_point import moment_filter
from engine.statespace.first_state import moments_of_first


def tank(linear=False, spread=1.5):
    """A level that settles; the first covariance is a guess."""
    own = {"linear" if linear else "nonlinear": {"level": "m"}}
    other = {"nonlinear" if linear else "linear": {}}

    def drift(a, u, t, th):
        return ([th.k * 2.0], [[-th.k]]) if linear else ([th.k * (2.0 - a[:, 0])], np.zeros((1, 0)))

    def measurement(a, u, t, th):
        return ([0.0], [[1.0]], [[th.r]]) if linear else (a, np.zeros((1, 0)), [[th.r]])

    def initial(th):
        if linear:
            return engine.Gaussian(np.zeros(0), np.zeros((0, 0))), [5.0], [[spread**2]]
        return engine.Gaussian([5.0], [[spread**2]]), [], np.zeros((0, 0))

    return engine.continuous(
        name="settling",
        drift=drift,
        diffusion=lambda a, u, t, th: [[th.q]],
        measurement=measurement,
        initial=initial,
        outputs={"y": "m"},
        parameters=[
            engine.Parameter("k", 0.2, "1/h", (0.0, 5.0)),
            engine.Parameter("q", 1e-3, "m^2/h", (1e-9, 1.0)),
            engine.Parameter("r", 0.01, "m^2", (1e-6, 1.0)),
        ],
        **own,
        **other,
    )


def records(scatter, n=10, seed=1):
    """In closed form, from first levels that scatter around 5 m."""
    rng, out = np.random.default_rng(seed), []
    for _ in range(n):
        t = np.sort(rng.uniform(0.0, 12.0, 9))
        t[0] = 0.0
        y = 2.0 + (3.0 + scatter * rng.standard_normal()) * np.exp(-0.2 * t)
        out.append(engine.Series(y + 0.1 * rng.standard_normal(9), t=t, time_unit="h"))
    return out


def effects_of(model, series, kinds=("start-scatter",)):
    return all_effects(setting_for(model, series, np.asarray(model.theta())), kinds)


@pytest.mark.parametrize("linear", [False, True])
def test_the_first_covariance_is_as_many_times_as_large(linear):
    model = tank(linear)
    (effect,) = effects_of(model, together(in_turn(records(0.1))))
    extended = effect.apply(model)
    record = extended.record(extended.theta({effect.size.name: np.log(0.2)}))
    mean, cov = moments_of_first(extended, record)
    assert mean[0] == pytest.approx(5.0)
    assert cov[0, 0] == pytest.approx((0.2 * 1.5) ** 2)


def test_at_size_zero_it_is_the_model():
    model, series = tank(), together(in_turn(records(0.1)))
    extended = effects_of(model, series)[0].apply(model)
    own, base = (
        moment_filter(m, np.asarray(m.theta())[None], series).log_likelihood
        for m in (extended, model)
    )
    assert own[0] == pytest.approx(base[0], abs=1e-9)


def test_a_record_alone_and_a_first_state_that_is_known_have_none():
    assert not effects_of(tank(), records(0.1)[0])
    assert not effects_of(tank(), together(in_turn(records(0.1, 3))))
    assert not effects_of(tank(spread=0.0), together(in_turn(records(0.1))))


ASKED = ["start-scatter", "start", "force", "drag", "parameter-drift"]


@pytest.mark.long
def test_it_is_named_where_records_begin_farther_apart():
    found = engine.diagnose(tank(), records(6.0), effects=ASKED, held_out=0, processes=1)
    assert found.causes[0].effect == "start-scatter:level"
    assert found.verdict.value in ("named", "set")


@pytest.mark.long
@pytest.mark.parametrize("scatter", [1.5, 0.05])
def test_nothing_is_found_where_they_begin_as_the_model_says_or_closer_together(scatter):
    found = engine.diagnose(tank(), records(scatter), effects=ASKED, held_out=0, processes=1)
    assert found.verdict.value == "nothing"


@pytest.mark.long
def test_that_they_begin_closer_together_is_a_rival_of_what_makes_up_for_it():
    """A sensor that makes all first readings alike, whatever the process noise would have to be."""
    model, series = tank(), together(in_turn(records(0.05, 30)))
    fit = quasi_ml(model, series)
    effects = effects_of(model, series, ["start-scatter", "gain"])
    refits = {}
    for effect in effects:
        start = [*np.asarray(fit.theta), -0.5, *effect.probes[0]]
        free = [*fit.free, effect.size.name]
        refits[effect.kind] = quasi_ml(effect.apply(model), series, start, free).log_likelihood
    assert refits["start-scatter"] > max(refits["gain"], fit.log_likelihood + 40.0)
