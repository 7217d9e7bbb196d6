"""RBPF, joint trajectories and conditional moments against the exact Kalman and RTS answers.

One model with everything at once: A_a != 0, Q_az != 0, singular P_1, an input, time-varying
matrices, irregular time stamps, missing rows and channels, ESS-triggered resampling. Errors are
root mean squares over all elements and replicates; they must fall like M^(-1/2). The fitted
slope has a standard error of about 0.04 (measured over seeds), so the interval -0.5 +- 0.15 is
left in about 1 of 5000 seeds; the seed is fixed anyway.
"""

from __future__ import annotations

import numpy as np
import pytest

from engine import condition_on_trajectories, kalman_smoother, rb_ffbsi, rbpf
from tests.engine.models_for_tests import awkward_series, linear_mixed

SIZES = (60, 240, 960)
FILTERS, SMOOTHERS = 48, 12  # replicates
CASES = {
    "common": linear_mixed(),
    "per particle": linear_mixed(particle_shaped=True),
    "na = 0": linear_mixed(na=0),
    "nz = 0": linear_mixed(nz=0),
    "na = 1": linear_mixed(na=1),
}


def filter_errors(model, series, exact, M, rng, proposal):
    f = rbpf(model, None, series, M, rng, proposal=proposal, ess_threshold=0.5)
    x = np.concatenate([f.a, f.z], axis=2)
    mean = np.einsum("tm,tmx->tx", f.weights, x)
    cov = np.einsum("tm,tmx,tmy->txy", f.weights, x, x) - mean[:, :, None] * mean[:, None, :]
    na = model.na
    cov[:, na:, na:] += np.einsum("tm,tmxy->txy", f.weights, f.P)
    errors = {
        "mean": mean - exact.x_filtered,
        "covariance": cov - exact.P_filtered,
        "log-likelihood": f.log_likelihood - exact.log_likelihood,
    }
    return errors, f


def smoother_errors(model, exact, f, M, rng):
    s = rb_ffbsi(f, M, rng, joint=True)
    x = s.trajectories
    centred = x - x.mean(axis=1, keepdims=True)
    errors = {
        "joint mean": x.mean(axis=1) - exact.x,
        "joint covariance": np.einsum("tnx,tny->txy", centred, centred) / M - exact.P,
        "joint cross-covariance": np.einsum("tnx,tny->txy", centred[:-1], centred[1:]) / M
        - exact.M,
    }
    c = condition_on_trajectories(s)
    x = np.concatenate([c.a, c.z], axis=2)
    centred = x - x.mean(axis=1, keepdims=True)
    na = model.na
    cov = np.einsum("tnx,tny->txy", centred, centred) / M
    cov[:, na:, na:] += c.P.mean(axis=1)
    cross = np.einsum("tnx,tny->txy", centred[:-1], centred[1:]) / M
    cross[:, na:, na:] += c.M.mean(axis=1)
    errors |= {
        "conditional mean": x.mean(axis=1) - exact.x,
        "conditional covariance": cov - exact.P,
        "conditional cross-covariance": cross - exact.M,
    }
    return errors


def rms(model, series, proposal, smoothers=SMOOTHERS, seed=6):
    """{quantity: rms error for each M}, and how often the filter resampled."""
    exact = kalman_smoother(model, None, series)
    out: dict[str, list[float]] = {}
    resampled = 0
    for M in SIZES:
        squares: dict[str, list[float]] = {}
        for replicate in range(FILTERS):
            rng = np.random.default_rng([seed, M, replicate])
            errors, f = filter_errors(model, series, exact, M, rng, proposal)
            if replicate < smoothers:
                errors |= smoother_errors(model, exact, f, M, rng)
            resampled += int(np.count_nonzero((f.ess <= 0.5 * M)[:-1]))
            for name, error in errors.items():
                squares.setdefault(name, []).append(float(np.mean(np.square(error))))
        for name, values in squares.items():
            out.setdefault(name, []).append(float(np.sqrt(np.mean(values))))
    return out, resampled


def slopes(errors):
    return {name: np.polyfit(np.log(SIZES), np.log(v), 1)[0] for name, v in errors.items()}


@pytest.mark.slow
@pytest.mark.parametrize("case", ["common", "na = 1", "nz = 0"])
def test_errors_fall_like_one_over_root_m(case):
    model = CASES[case]
    series = awkward_series(model)
    errors, resampled = rms(model, series, "adapted")
    assert resampled > 100  # of 3 * 48 runs over 20 rows: now and then, not at every row
    assert resampled < 3 * FILTERS * 15
    for name, slope in slopes(errors).items():
        assert -0.65 < slope < -0.35, f"{name}: errors {errors[name]}, slope {slope:.2f}"
        assert errors[name][-1] < (0.25 if name == "log-likelihood" else 0.05), errors[name]


@pytest.mark.long
def test_bootstrap_and_adapted_agree_in_distribution():
    """Both converge to the same exact answers; the adapted proposal has the smaller error."""
    model = CASES["common"]
    series = awkward_series(model)
    blind, _ = rms(model, series, "bootstrap", smoothers=0)
    adapted, _ = rms(model, series, "adapted", smoothers=0)
    for name, slope in slopes(blind).items():
        assert -0.68 < slope < -0.32, f"{name}: errors {blind[name]}, slope {slope:.2f}"
        assert adapted[name][-1] < blind[name][-1]


def test_without_nonlinear_states_the_filter_and_smoother_are_exact():
    model = CASES["na = 0"]
    series = awkward_series(model)
    exact = kalman_smoother(model, None, series)
    f = rbpf(model, None, series, 1, np.random.default_rng(0))
    assert f.log_likelihood == pytest.approx(exact.log_likelihood, abs=1e-9)
    np.testing.assert_allclose(f.z[:, 0], exact.x_filtered, atol=1e-10)
    np.testing.assert_allclose(f.P[:, 0], exact.P_filtered, atol=1e-10)
    s = condition_on_trajectories(rb_ffbsi(f, 1, np.random.default_rng(0), joint=True))
    np.testing.assert_allclose(s.z[:, 0], exact.x, atol=1e-10)
    np.testing.assert_allclose(s.P[:, 0], exact.P, atol=1e-10)
    np.testing.assert_allclose(s.M[:, 0], exact.M, atol=1e-10)
    three = rb_ffbsi(f, 1, np.random.default_rng(0))  # nothing is approximate here either
    np.testing.assert_allclose(three.P[:, 0], exact.P, atol=1e-10)


def test_common_and_particle_shaped_matrices_give_the_same_numbers():
    common, shaped = CASES["common"], CASES["per particle"]
    series = awkward_series(common)
    for joint in (True, False):
        results = []
        for model in (common, shaped):
            rng = np.random.default_rng(7)
            s = rb_ffbsi(rbpf(model, None, series, 40, rng), 30, rng, joint=joint)
            results.append((s, condition_on_trajectories(s)))
        for one, other in zip(*results, strict=True):
            np.testing.assert_allclose(one.a, other.a, atol=1e-9)
            np.testing.assert_allclose(one.z, other.z, atol=1e-9)
            np.testing.assert_allclose(one.P, other.P, atol=1e-9)
            np.testing.assert_allclose(one.M, other.M, atol=1e-9)
