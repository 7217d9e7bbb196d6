"""A state with two likely values: the moment filter is far from the likelihood, and no name rests on it."""

from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.diagnose.held_out import HeldOut, Judged
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.judging.moments_missed import log_likelihood_of, missed_in_words, nats_missed
from engine.estimation.quasi_ml import QuasiFit

ROWS = 240


def growth():
    """The growth model of the literature: an echo of the state squared, and a linear channel beside it."""

    def dynamics(a, u, t, dt, theta):
        x = a[:, 0]
        return (
            [theta.c * x + 25 * x / (1 + x**2) + 8 * np.cos(1.2 * t), 0.0],
            [[1.0], [0.9]],
            [
                [theta.q, 0.0],
                [0.0, 0.1],
            ],
        )

    def measurement(a, u, t, theta):
        return [a[:, 0] ** 2 / 20, 0.0], [[0.0], [1.0]], np.diag([theta.r, 0.1])

    def initial(theta):
        return engine.Gaussian([0.0], [[5.0]]), [0.0], [[0.5]]

    return engine.MixedModel(
        name="growth",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"x": "1"},
        linear={"z": "1"},
        outputs={"echo": "1", "side": "1"},
        parameters=[
            engine.Parameter("c", 0.5, "1", (-0.95, 0.95)),
            engine.Parameter("q", 1.0, "1", (1e-3, 50.0)),
            engine.Parameter("r", 1.0, "1", (1e-3, 50.0)),
        ],
    )


def fit_at(model, theta=None):
    """A fit that nobody made."""
    return QuasiFit(model, model.theta(theta), 0.0, (), np.zeros((0, 0)), 1, True)


def series_of(model, seed=1, rows=ROWS):
    return engine.simulate(model, None, rows, np.random.default_rng(seed), dt=1.0).series


@pytest.mark.long
def test_it_is_known_where_particles_find_a_record_far_likelier():
    model = growth()
    fit, series = fit_at(model), series_of(model)
    missed = nats_missed(fit, fit, series, 0)
    particles = engine.rbpf(model, None, series, 2000, 5).log_likelihood
    assert missed > 100.0
    assert log_likelihood_of(fit, series) + missed == pytest.approx(particles, abs=10.0)


@pytest.mark.parametrize("name", ["mixed-4", "linear-2", "local-level"])
def test_it_is_not_said_where_the_filters_agree(name):
    model = engine.get_model(name)
    fit = fit_at(model)
    assert nats_missed(fit, fit, series_of(model), 0) == 0.0


def test_where_particles_are_lost_the_fit_before_is_asked():
    """Nearly without noise few particles follow nothing, and that they are far below tells nothing."""
    model = growth()
    lost = fit_at(model, {"c": -0.9, "q": 1e-3, "r": 1e-3})
    series = series_of(model)
    assert nats_missed(lost, lost, series, 0) == 0.0
    assert nats_missed(fit_at(model), lost, series, 0) > 100.0


@pytest.mark.parametrize(
    ("gained", "verdict", "end"),
    [(10.0, Verdict.UNKNOWN, "no cause is named."), (1e6, Verdict.NAMED, "filter, 1000000.")],
)
def test_a_name_that_gains_less_than_is_missed_is_not_said(monkeypatch, gained, verdict, end):
    model = growth()
    before, after = fit_at(model), fit_at(model)
    record = HeldOut(SimpleNamespace(), series_of(model), 0, 0.05)
    monkeypatch.setattr(
        import_module("engine.diagnose.held_out"),
        "log_likelihood_of",
        lambda fit, series: gained if fit is after else 0.0,
    )
    judged = Judged(Verdict.NAMED, ("a cause",), before, after, None, None, None, ("more",))
    heeded = record._heeding_particles(judged)
    assert heeded.verdict is verdict
    assert heeded.notes[0].endswith(end)
    assert heeded.notes[1:] == ("more",)


def test_a_clean_bill_says_what_it_rests_on():
    said = missed_in_words(84.2, 0.0, False)
    assert "84 nats likelier" in said
    assert said.endswith("An effect may be there that the search does not see.")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_is_named_of_the_very_model_that_made_the_record(seed):
    model = growth()
    found = engine.diagnose(
        model, series_of(model, seed, 300), effects=["drag", "saturation", "deadzone"]
    )
    assert found.verdict not in (Verdict.NAMED, Verdict.SET)
    assert any("takes what is known of a state for Gaussian" in note for note in found.notes)
