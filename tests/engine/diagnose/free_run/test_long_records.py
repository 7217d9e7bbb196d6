"""What a search on a long record spares itself, and what it must not: runs begun nearby, windows that tell."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.data.series import Series
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.free_run import windows
from engine.diagnose.free_run_fits.columns import columns
from engine.diagnose.free_run_fits.fitted import fit_runs
from engine.diagnose.free_run_fits.folds import folds_of, losses
from engine.estimation.start import WarmStart
from engine.simulation import problem
from engine.simulation.problem import FreeRunProblem
from engine.simulation.simulate import propagate, states_of
from engine.simulation.whole_record import whole_record
from tests.engine.simulation.free_run_models import unstable

T = 1000
HIDDEN = engine.get_model("oscillator", ["hysteresis:velocity"])
STRONG = {"hysteresis_velocity": -100.0, "hysteresis_velocity_width": 0.05}


def _record(model, theta, rows=T):
    u = np.repeat(np.random.default_rng(rows).uniform(0.1, 1.0, rows // 25), 25)
    told = {**theta, "sigma_v": 1e-3, "sigma_y": 1e-3}
    return engine.simulate(model, told, rows, np.random.default_rng(0), u=u, dt=0.1).series


@pytest.mark.long
def test_a_run_that_is_not_found_from_nothing_is_found_beside_another():
    """The loop over time is for what no guess reaches; the run is the same."""
    theta = HIDDEN.theta(STRONG)
    record, series, x1 = HIDDEN.record(theta), _record(HIDDEN, STRONG), np.zeros(HIDDEN.nx)
    assert len(whole_record(HIDDEN, record, series, x1)) < T
    _, a, z = propagate(HIDDEN, record, series, x1[None, : HIDDEN.na], x1[None, HIDDEN.na :])
    run = np.concatenate((a[:, 0], z[:, 0]), axis=1)
    np.testing.assert_array_equal(states_of(HIDDEN, record, series, x1), run)
    near = HIDDEN.record(HIDDEN.theta({**STRONG, "omega": 1.001 * theta["omega"]}))
    guess = states_of(HIDDEN, near, series, x1)
    assert len(whole_record(HIDDEN, record, series, x1, guess)) == T
    moved = np.abs(run).max(axis=0)
    np.testing.assert_allclose(
        states_of(HIDDEN, record, series, x1, guess) / moved, run / moved, atol=1e-8
    )
    wild = np.random.default_rng(1).standard_normal(guess.shape)
    np.testing.assert_allclose(
        states_of(HIDDEN, record, series, x1, wild) / moved, run / moved, atol=1e-8
    )


@pytest.mark.slow
def test_what_an_effect_does_is_asked_beside_the_fit_s_own_run():
    series = _record(HIDDEN, STRONG)
    fit = fit_runs(
        HIDDEN, [series], HIDDEN.theta(STRONG), ("omega", "gain"), np.zeros((1, HIDDEN.nx))
    )
    setting = setting_for(HIDDEN, series, np.asarray(fit.theta))
    effects = [make_effect(name, setting) for name in ("delay:drive", "pole:velocity")]
    found = columns(fit, effects)
    assert {column.effect.kind for column in found} == {"delay", "pole"}
    fit.problem.runs = [None]
    for one, other in zip(found, columns(fit, effects), strict=True):
        np.testing.assert_allclose(one.g, other.g, atol=1e-5 * np.abs(one.g).max())


def test_derivatives_are_kept_where_residuals_change_as_they_foretell(monkeypatch):
    """Fits that leave a fold out begin at a minimum: most of their steps need no derivatives of their own."""
    series = _record(HIDDEN, {"hysteresis_velocity": -2.0, "hysteresis_velocity_width": 0.1})
    theta = HIDDEN.theta({"hysteresis_velocity": -2.0, "hysteresis_velocity_width": 0.1})
    free = ("omega", "zeta", "gain", "hysteresis_velocity")
    fit = fit_runs(HIDDEN, [series], theta, free, np.zeros((1, HIDDEN.nx)))
    folds, taken = folds_of(fit.records), []
    slopes = FreeRunProblem._slopes

    def counted(*args):
        taken.append(1)
        return slopes(*args)

    monkeypatch.setattr(FreeRunProblem, "_slopes", counted)
    kept, few = losses(fit, folds), len(taken)
    monkeypatch.setattr(problem, "BENT", 0.0)
    anew = losses(fit, folds)
    assert 2 * few <= len(taken) - few
    np.testing.assert_allclose(kept, anew, atol=5e-2)


def test_a_run_that_is_lost_ends_there():
    """Nothing is calculated behind the row at which it is not finite any more."""
    model = unstable(1.5)
    seen = []

    def dynamics(a, u, t, dt, theta):
        if np.ndim(t) == 0:  # the loop's, and some rows that are tried
            seen.append(float(t))
        return model.dynamics(a, u, t, dt, theta)

    counted = replace(model, dynamics=dynamics)
    series = Series(np.zeros(3000), np.ones(3000), dt=1.0)
    run = states_of(counted, counted.record(counted.theta()), series, np.ones(1))
    lost = int(np.argmin(np.isfinite(run[:, 0])))
    assert 0 < lost < 2000
    assert not np.isfinite(run[lost:]).any()
    assert len(seen) < 1000  # of the 1200 and more that are left


def _table(theta, q):
    values = np.array([getattr(theta, f"k{i}") for i in range(6)])
    at = np.clip(q.astype(int), 0, 5)
    return values[at] if values.ndim == 1 else values[at, np.arange(len(q))]


TABLE = engine.MixedModel(
    name="table",
    nonlinear={"charge": "1"},
    inputs={"current": "1/s"},
    outputs={"voltage": "V"},
    parameters=[
        *(engine.Parameter(f"k{i}", 1.0, "V", (-50.0, 50.0)) for i in range(6)),
        engine.Parameter("sigma", 0.1, "V", (1e-3, 10.0)),
    ],
    dynamics=lambda a, u, t, dt, theta: ([a[:, 0] + dt * u[0]], np.zeros((1, 0)), [[1e-10]]),
    measurement=lambda a, u, t, theta: (
        [_table(theta, a[:, 0])],
        np.zeros((1, 0)),
        [[theta.sigma**2]],
    ),
    initial=lambda theta: (engine.Gaussian([0.5], [[1e-8]]), [], np.zeros((0, 0))),
)
LONG = Series(np.repeat(np.arange(6.0), 1000), np.full(6000, 1e-3), dt=1.0)


@pytest.mark.long
def test_windows_that_are_silent_on_what_the_record_tells_are_no_picture_of_it():
    free = TABLE.parameter_names
    assert sum(map(len, windows.windows([LONG]))) <= windows.MOST_ROWS
    assert windows.telling(TABLE, None, free, [LONG]) == [LONG]
    known = [name for name in free if name != "k3"]
    missed = windows._silent(TABLE, None, free, windows.windows([LONG])) - {"sigma"}
    assert missed
    told = [name for name in known if name not in missed]
    assert len(windows.telling(TABLE, None, told, [LONG])) > 1


def test_the_likelihood_searches_all_rows_where_some_are_silent_on_what_the_record_tells():
    longer = Series(np.repeat(np.arange(6.0), 2000), np.full(12_000, 5e-4), dt=1.0)
    assert windows.rows_searched(TABLE, None, None, longer) == (0, 12_000)
    assert windows.rows_searched(TABLE, None, ["k0", "k1", "sigma"], longer) == (0, 3000)
    held = Series(np.zeros(12_000), np.zeros(12_000), dt=1.0)  # where no row tells more than others
    begin, end = windows.rows_searched(TABLE, None, None, held)
    assert end - begin == 3000


@pytest.mark.slow
def test_parameters_of_which_the_rows_searched_tell_nothing_keep_their_start():
    start = TABLE.theta({"k4": 2.5, "k5": 3.5})
    found, *_ = WarmStart(TABLE, [LONG.part(0, 2000)], TABLE.free_indices(None))(start)
    assert (found["k4"], found["k5"]) == (2.5, 3.5)
    assert found["k0"] == pytest.approx(0.0, abs=0.05)
    assert found["k2"] == pytest.approx(1.0, abs=0.05)
