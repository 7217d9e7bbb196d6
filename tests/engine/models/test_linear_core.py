"""The core of the linear models: what it remembers between calls must never be stale."""

import numpy as np
import pytest

from engine.models.linear_core import LinearCore
from engine.models.oscillator import CORE as OSCILLATOR


def _decay(values):
    rate, _ = np.moveaxis(values, -1, 0)
    F = -rate[..., None, None]
    return F, np.ones_like(F), np.ones_like(F)


def _read_only(values):
    out = np.array(values)
    out.setflags(write=False)
    return out


@pytest.mark.parametrize("rate", [2.0, np.array([2.0, 3.0]), _read_only([2.0, 3.0])])
def test_the_step_is_exact_however_the_parameters_come(rate):
    core = LinearCore(_decay)
    for dt in (0.1, 0.1, 0.2, 0.1):
        A, B, Q = core(rate, dt)
        np.testing.assert_allclose(A[..., 0, 0], np.exp(-rate * dt), rtol=1e-12)
        np.testing.assert_allclose(B[..., 0, 0], (1.0 - np.exp(-rate * dt)) / rate, rtol=1e-12)
        np.testing.assert_allclose(
            Q[..., 0, 0], (1.0 - np.exp(-2.0 * rate * dt)) / (2.0 * rate), rtol=1e-12
        )


def test_an_array_changed_in_place_is_seen():
    core = LinearCore(_decay)
    rate = np.array([2.0, 3.0])
    core(rate, 0.1)
    rate[0] = 5.0
    np.testing.assert_allclose(core(rate, 0.1)[0][:, 0, 0], np.exp(-rate * 0.1), rtol=1e-12)


def test_the_matrices_cannot_be_spoiled_by_who_gets_them():
    core = LinearCore(_decay)
    for values in ((2.0, 0.1), (_read_only([2.0, 3.0]), 0.1)):
        with pytest.raises(ValueError, match="read-only"):
            core(*values)[0][...] = 0.0


def test_rows_together_are_those_alone_also_of_a_stiff_core():
    """Rounding a parameter in one of the two would be magnified: 430 rad/s, seen at 0.4 ms."""
    rng = np.random.default_rng(3)
    values = np.array([430.0, 0.05, 10.0]) * np.exp(0.7 * rng.standard_normal((9, 3)))
    dt = 2.0**14 / 4e7
    together = OSCILLATOR(*values.T, dt)
    for i, own in enumerate(values.tolist()):
        for many, one in zip(together, OSCILLATOR(*own, dt), strict=True):
            np.testing.assert_allclose(many[i], one, rtol=1e-14)
