"""One backward pass scores a disturbance at every time, and with it every course of disturbances."""

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.screening.disturbances import (
    _fourier_sums,
    backward,
    best_frequencies,
    pulse_scores,
)
from engine.diagnose.screening.score_columns import Projection, parameter_columns
from engine.diagnose.screening.time_scan import family_test, grid
from engine.estimation.quasi_ml import quasi_ml
from engine.filters.sigma_point import moment_filter, moment_path
from tests.engine.hidden_effects import DRIVE, DT, hidden, levels


def drive(n, seed=1):
    rng = np.random.default_rng(seed)
    return engine.simulate(DRIVE, None, n, rng, u=levels(rng, n), dt=DT).series


@pytest.mark.parametrize("channel", ["speed", "reading"])
def test_pulse_scores_are_derivatives_of_the_likelihood(channel):
    series = drive(60)
    theta = np.asarray(DRIVE.theta())
    path = moment_path(DRIVE, theta, series)
    b, e = np.zeros((59, 2)), np.zeros((60, 1))
    if channel == "speed":
        b[:, 0] = DT
    else:
        e[:, 0] = 1.0
    scores, information = pulse_scores(path, series, b, e)
    effect = make_effect(f"pulse:{channel}", setting_for(DRIVE, series, DRIVE.theta()))
    extended = effect.apply(DRIVE)
    size = 1e-4
    for row in (1, 17, 40):
        both = [[*theta, s, series.t[row], *effect.probes[0][1:]] for s in (-size, 0.0, size)]
        low, at, high = moment_filter(extended, np.array(both), series).log_likelihood
        assert scores[row] == pytest.approx((high - low) / (2.0 * size), rel=1e-4)
        assert information[row] == pytest.approx(-(high - 2.0 * at + low) / size**2, rel=1e-2)


@pytest.mark.parametrize("n", [400, 3000])
def test_a_harmonic_is_found_at_any_frequency_and_length(n):
    """A frequency between those of a grid of 400 is lost on a long record."""
    frequency = 0.7371
    values = {"harmonic_speed": 4.0 / np.sqrt(n), "harmonic_speed_frequency": frequency}
    series = hidden(["harmonic:speed"], values, seed=4, n=n)
    fit = quasi_ml(DRIVE, series)
    effect = make_effect("harmonic:speed", setting_for(DRIVE, series, fit.theta))
    theta = np.asarray(fit.theta)
    indices = DRIVE.free_indices(fit.free)
    columns = parameter_columns(DRIVE, theta, indices, series)
    path = moment_path(DRIVE, theta, series)
    found = family_test(effect, DRIVE, theta, series, path, Projection(columns))
    assert found is not None
    assert found.tries == len(grid(effect, series))
    statistic = float(found.statistics(found.s.sum(axis=1)).max())
    assert statistic > 2.0 * np.log(found.tries) + 9.0
    assert abs(found.at[0][1] - frequency) < 0.5 / (n * DT)


def test_frequencies_are_found_alike_on_equal_and_on_written_out_times():
    """By the chirp z-transform, and by sums."""
    series = drive(300)
    written = engine.Series(
        series.y,
        series.u,
        t=series.t * (1.0 + 1e-7 * np.sin(np.arange(300))),
        y_names=series.y_names,
    )
    assert series.dt is not None
    assert written.dt is None
    path = moment_path(DRIVE, np.asarray(DRIVE.theta()), series)
    e = np.ones((300, 1))
    frequencies = np.linspace(0.05, 4.8, 250)
    both = [
        best_frequencies(path, s, np.zeros((299, 2)), e, frequencies, 10) for s in (series, written)
    ]
    assert len(both[0]) == 10
    np.testing.assert_array_equal(*both)


def test_a_gap_between_two_sessions_does_not_make_the_frequencies_endless():
    t = np.concatenate([np.arange(50) * DT, 1e6 + np.arange(50) * DT])
    series = engine.Series(np.zeros((100, 1)), np.zeros((100, 1)), t=t)
    effect = make_effect("harmonic:speed", setting_for(DRIVE, series, DRIVE.theta()))
    assert len(grid(effect, series)) == 200


def test_a_pulse_is_found_on_any_row_but_the_first_and_the_last():
    base = drive(120)
    for row in (1, 60, 118):
        y = base.y.copy()
        y[row] += 5.0
        series = engine.Series(y, base.u, dt=DT, y_names=base.y_names, u_names=base.u_names)
        fit = quasi_ml(DRIVE, base)
        theta = np.asarray(fit.theta)
        effect = make_effect("pulse:reading", setting_for(DRIVE, series, fit.theta))
        path = moment_path(DRIVE, theta, series)
        found = family_test(effect, DRIVE, theta, series, path, Projection([]))
        assert found is not None
        assert found.at[0][0] == pytest.approx(series.t[row])


@pytest.mark.parametrize(("rows", "frequencies"), [(40, 7), (301, 250), (64, 900)])
def test_the_chirp_transform_is_the_sum_written_out(rows, frequencies):
    series, x = drive(rows), np.random.default_rng(2).standard_normal(rows)
    at = np.linspace(0.05, 4.8, frequencies)
    expected = np.exp(-2j * np.pi * np.outer(at, series.t - series.t[0])) @ x
    np.testing.assert_allclose(_fourier_sums(x, series, at), expected, atol=1e-9)


def test_a_way_is_gone_back_once():
    series = drive(60)
    path = moment_path(DRIVE, np.asarray(DRIVE.theta()), series)
    assert backward(path, series) is backward(path, series)
    gap = series.replace(y=np.where(np.arange(60)[:, None] == 30, np.nan, series.y))
    there = moment_path(DRIVE, np.asarray(DRIVE.theta()), gap)
    assert not backward(there, gap).D[30].any()  # what is missing tells nothing
    assert np.isfinite(backward(there, gap).u).all()
