"""The linearised free run against plain least squares."""

import itertools

import numpy as np
import pytest

from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.free_run_fits.columns import columns
from engine.diagnose.free_run_fits.folds import folds_of
from engine.diagnose.free_run_fits.linear import Linear
from engine.kernels.pairs import best_pairs
from engine.simulation.free_run import free_run
from tests.engine.diagnose.free_run.cubic import MODEL, fit_beside_cubic

EFFECTS = ("cubic:position->velocity", "bias:y", "drag:velocity", "input-offset:drive")


@pytest.fixture(scope="module")
def fit():
    return fit_beside_cubic(1)


@pytest.fixture(scope="module")
def linear(fit):
    setting = setting_for(MODEL, fit.records[0], np.asarray(fit.theta))
    return Linear(fit, columns(fit, [make_effect(name, setting) for name in EFFECTS]))


def test_a_column_is_the_difference_of_two_runs(fit, linear):
    for column in linear.columns:
        model = column.effect.apply(MODEL)
        own = [p.default for p in column.effect.parameters]
        own[1 : 1 + len(column.probe)] = column.probe
        runs = []
        h = 1e-4 * fit.rms / max(np.sqrt(np.mean(column.g**2)), 1e-30)
        for size in (-h, h):
            theta = model.theta([*fit.theta, size, *own[1:]])
            states = dict(zip((*MODEL.nonlinear, *MODEL.linear), fit.x1[0], strict=True))
            a1 = [states[name] for name in model.nonlinear]
            z1 = [states.get(name, 0.0) for name in model.linear]
            runs.append(free_run(model, theta, fit.records[0], a1, z1).y[:, 0])
        slope = (runs[1] - runs[0]) / (2.0 * h)
        np.testing.assert_allclose(column.g, slope, atol=2e-3 * np.abs(slope).max())


def _left(fit, *columns):
    """Squared error that least squares on the fit's derivatives and some columns leaves."""
    A = np.column_stack([fit.J, *columns])
    A = A / np.linalg.norm(A, axis=0)
    return np.linalg.lstsq(A, fit.e, rcond=1e-12)


def test_shares_are_those_of_least_squares(fit, linear):
    whole = float(np.sum((fit.e - fit.J @ np.linalg.lstsq(fit.J, fit.e, rcond=None)[0]) ** 2))
    shares = {s.names[0]: s for s in linear.singles()}
    for column in linear.columns:
        gone = 1.0 - float(_left(fit, column.g)[1][0]) / whole
        assert shares[column.effect.name].share >= gone - 1e-6
    pairs = {frozenset(s.names): s.share for s in linear.pairs(100)}
    for a, b in itertools.combinations(linear.columns, 2):
        key = frozenset((a.effect.name, b.effect.name))
        if key in pairs:
            gone = 1.0 - float(_left(fit, a.g, b.g)[1][0]) / whole
            assert pairs[key] >= gone - 1e-6
    assert shares["cubic:position->velocity"].share == max(s.share for s in shares.values())


def test_the_best_pair_of_many_series_is_that_of_each(fit, linear):
    """Also where columns have one sign only, and where no pair may take anything."""
    rng = np.random.default_rng(1)
    E = np.column_stack([fit.e, rng.standard_normal((len(fit.e), 20))])
    z, (i, j) = linear.Z @ linear.beside(E), linear._couples
    one_sided = linear.one_sided.copy()
    for sides in (~one_sided, np.ones_like(one_sided), one_sided):
        linear.one_sided[:] = sides
        at = best_pairs(z, linear.C, i, j, linear.one_sided)
        shares = np.array([linear._pair_shares(own, 1.0) for own in z.T]).T
        assert at.tolist() == np.argmax(shares, axis=0).tolist()
    assert (best_pairs(-np.abs(z), np.eye(len(z)), i, j, np.ones_like(one_sided)) == 0).all()


def test_the_gain_on_rows_left_out_is_that_of_least_squares_on_the_others(fit, linear):
    folds = folds_of(fit.records)
    rng = np.random.default_rng(0)
    E = np.column_stack([fit.e, rng.standard_normal((len(fit.e), 2))])
    found = linear.held_out_gains(E, folds)
    G = np.array([column.g for column in linear.columns]).T
    for s, e in enumerate(E.T):
        beside = linear.beside(e)
        z = linear.Z @ beside
        single = int(np.argmax(z * z))
        pairs = list(itertools.combinations(range(G.shape[1]), 2))
        shares = []
        for i, j in pairs:
            c = linear.C[i, j]
            same = linear.columns[i].effect.name == linear.columns[j].effect.name
            if same or abs(c) >= 0.97:
                shares.append(0.0)
                continue
            shares.append((z[i] ** 2 + z[j] ** 2 - 2 * c * z[i] * z[j]) / (1 - c * c))
        chosen = [(single,), pairs[int(np.argmax(shares))]]
        gains = []
        for which in chosen:
            gained = []
            for fold in range(4):
                out = folds.out(fold)
                left = [_predicted(fit.J, G[:, [*which]][:, :k], e, out) for k in (0, len(which))]
                for b in np.unique(folds.block[out]):
                    own = folds.block[out] == b
                    gained.append(np.log(np.mean(left[0][own] ** 2) / np.mean(left[1][own] ** 2)))
            gains.append(np.mean(gained))
        assert found[s] == pytest.approx(max(gains), rel=1e-4, abs=1e-6)


def _predicted(J, G, e, out):
    A = np.column_stack([J, G])
    A = A / np.linalg.norm(A, axis=0)
    x = np.linalg.lstsq(A[~out], e[~out], rcond=1e-12)[0]
    return e[out] - A[out] @ x
