"""Inputs that ran on straight lines: a cause where the record does not say so, nothing where it does."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import engine
from engine import Series
from engine.diagnose import all_effects
from engine.diagnose.effects.of_series import setting_for

OMEGA, ZETA, DT = 6.0, 0.05, 0.12  # nine samples a period


@pytest.fixture(scope="module")
def record():
    """An oscillator of which an integrator that is not ours made the readings."""
    rng, T = np.random.default_rng(7), 150
    u = np.convolve(rng.standard_normal(T + 2), np.ones(3) / 3.0, "valid")
    t = DT * np.arange(T)
    found = solve_ivp(
        lambda at, x: [
            x[1],
            OMEGA**2 * (np.interp(at, t, u) - x[0]) - 2.0 * ZETA * OMEGA * x[1],
        ],
        (0.0, t[-1]), [0.0, 0.0], t_eval=t, max_step=0.5 * DT, rtol=1e-9, atol=1e-11,
    )  # fmt: skip
    return Series(found.y[0] + 0.01 * rng.standard_normal(T), u, dt=DT)


def asked(series):
    model = engine.get_model("oscillator")
    looked = engine.diagnose(model, series, effects=["hold", "delay", "linear"])
    return looked.verdict.value, [cause.effect for cause in looked.causes]


@pytest.mark.slow
def test_it_is_the_cause_where_the_record_says_held(record):
    assert asked(record) == ("named", ["hold:drive"])


@pytest.mark.slow
def test_it_is_none_where_the_record_says_so(record):
    assert asked(record.replace(hold="foh")) == ("nothing", [])


def test_it_is_no_candidate_where_the_record_says_so(record):
    model = engine.get_model("oscillator")
    for hold, there in (("zoh", True), ("foh", False), ("past", False)):
        setting = setting_for(model, record.replace(hold=hold), np.asarray(model.theta()))
        assert ("hold:drive" in [e.name for e in all_effects(setting)]) == there
