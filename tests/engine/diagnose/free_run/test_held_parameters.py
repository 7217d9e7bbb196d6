"""What the model has itself and holds at a wrong value is tried beside every leading effect."""

from __future__ import annotations

import numpy as np
import pytest

import engine
from engine.diagnose.free_run import search
from engine.diagnose.free_run.answer import setting_of
from engine.diagnose.free_run.search import refits
from engine.diagnose.free_run_fits.candidates import candidates, fit_of
from engine.diagnose.free_run_fits.columns import columns
from engine.diagnose.free_run_fits.linear import Linear
from engine.estimation.quasi_ml import quasi_ml

SERVO = engine.get_model("servo")
TRUTH = {"Fc": 20.0, "offset": -3.4, "sigma_v": 1e-6, "sigma_load": 1e-3, "sigma_y": 1e-4}
HELD = ("gtau", "Fc", "offset")


@pytest.mark.slow
def test_two_parameters_held_at_zero_are_refitted_together(monkeypatch):
    """Of a drive whose friction and offset its user took for zero, beside which other effects fit as well."""
    t = 0.04 * np.arange(500)
    u = 2.0 * np.sin(0.5 * t + 0.02 * t**2) + 0.5 * np.sign(np.sin(1.3 * t))
    rng = np.random.default_rng(5)
    series = engine.simulate(SERVO, TRUTH, 500, rng, u=u, dt=0.04).series
    free = [name for name in SERVO.parameter_names if name not in HELD]
    start = SERVO.theta({"Fc": 0.0, "offset": 0.0})
    fit = fit_of(quasi_ml(SERVO, series, start, free, max_iterations=5), [series])
    effects = candidates(fit, setting_of(fit, HELD, fit.records), ["held", "coulomb", "quadratic"])
    monkeypatch.setattr(Linear, "pairs", lambda self, most: [])  # as where other pairs take more,
    monkeypatch.setattr(search, "BESIDE", 0)  # and other effects beside the leading ones
    found = refits(fit, Linear(fit, columns(fit, effects)), effects, (), lambda *_: None)
    both = next(
        one for one in found if set(one.names[len(fit.names) :]) == {"held:offset", "held:Fc"}
    )
    assert both.theta["held_Fc"] == pytest.approx(20.0, rel=0.05)
    assert both.theta["held_offset"] == pytest.approx(-3.4, rel=0.05)
