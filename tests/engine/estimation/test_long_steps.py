"""Estimates of models that make too long a step say so; see also ``simulation/test_step_length.py``."""

from __future__ import annotations

import numpy as np
import pytest

import engine
from engine.estimation.long_steps import FOR_ESTIMATES, about_predictions
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.simulation.test_step_length import TOO_LONG, advised, pendulum, swings

QUICK = {"n_particles": 10, "n_iterations": 2, "warm_start": False}
NEAR = {"w2": 39.4, "d": 0.26, "q": 0.02, "r": 4e-4}  # where estimates by long steps end


@pytest.mark.long
def test_maximum_likelihood_says_so_and_advises_enough():
    model, series = pendulum(), swings()
    found = engine.rbps_em(model, series, NEAR, **QUICK)
    assert "one-step predictions change by " in found.message
    fine = series.refined(advised(found.message))
    truth = {"w2": 40.0, "d": 0.2, "q": 1e-4, "r": 4e-4}
    assert TOO_LONG not in engine.rbps_em(model, fine, truth, **QUICK).message


@pytest.mark.parametrize(("q", "steps"), [(1e-2, 2), (1e-4, 4), (1e-4, 8), (1e-2, 8)])
def test_what_moves_an_estimate_by_half_an_error_is_told(q, steps):
    """And what moves none by a third of that is not."""
    model, truth, free = pendulum(), {"w2": 40.0, "d": 0.2, "q": q, "r": 4e-4}, ["w2", "d", "r"]
    coarse, fine = (quasi_ml(model, swings().refined(k), truth, free) for k in (steps, 32))
    moved = [
        abs(coarse.theta[name] - fine.theta[name]) / error
        for name, error in zip(free, fine.standard_errors, strict=True)
    ]
    said = about_predictions(model, np.asarray(coarse.theta), [swings().refined(steps)])
    assert bool(said) == (max(moved) > 0.5)


def test_particle_em_says_so():
    found = engine.ps_em(pendulum(), swings(), NEAR, n_particles=10, n_iterations=1)
    assert TOO_LONG in found.message


def test_standard_errors_say_so():
    with pytest.warns(engine.NotSettledWarning):
        errors = engine.standard_errors(pendulum(), NEAR, swings(), ["r"], 10, 10, replicates=2)
    assert errors.note.startswith(TOO_LONG)
    assert TOO_LONG in str(errors)
    assert TOO_LONG in errors._repr_html_().replace("&#x27;", "'").replace("&#39;", "'")


@pytest.mark.long
def test_a_diagnosis_that_finds_nothing_says_so():
    """Its own steps are short enough for effects, and not for the parameters that it shows."""
    found = engine.diagnose(pendulum(), swings(), effects=["bias"], held_out=0)
    assert not found.causes
    assert found.substeps > 1
    (note,) = (note for note in found.notes if "one-step predictions change by " in note)
    # which no finer series would change: a diagnosis does not take its steps
    assert note.endswith(FOR_ESTIMATES)


def test_exact_em_says_nothing_of_exact_steps():
    model = engine.get_model("oscillator")
    series = engine.simulate(model, None, 60, np.random.default_rng(0), u=np.ones(60), dt=0.3)
    assert "steps" not in engine.rts_em(model, series.series, n_iterations=1).message


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_units_change_nothing(unit):
    """Of the readings and the angle."""
    own = pendulum(
        drift=lambda a, u, t, th: (
            [0.0, -unit * th.w2 * np.sin(a[:, 0] / unit)], [[1.0], [-th.d]]
        ),
        diffusion=lambda a, u, t, th: unit**2 * np.diag([0.0, th.q]),
        measurement=lambda a, u, t, th: ([a[:, 0]], [[0.0]], [[th.r * unit**2]]),
        initial=lambda th: (
            engine.Gaussian([1.5 * unit], [[0.01 * unit**2]]), [0.0], [[0.01 * unit**2]]
        ),
    )  # fmt: skip
    series = swings()
    said = about_predictions(pendulum(), pendulum().theta(NEAR), [series])
    scaled = engine.Series(unit * series.y, dt=0.1)
    assert about_predictions(own, own.theta(NEAR), [scaled]) == said
