"""A delay of the input and one of the sensor say the same of a linear plant that begins at rest."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose import diagnose, extend, make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.estimation.quasi_ml import quasi_ml

DRUG = engine.continuous(
    name="drug",
    drift=lambda a, u, t, theta: ([u[0]], [[-theta.k]]),
    diffusion=lambda a, u, t, theta: [[1e-8]],
    measurement=lambda a, u, t, theta: ([0.0], [[1.0 / theta.V]], [[theta.r]]),
    initial=lambda theta: (None, [0.0], [[1e-6]]),
    linear={"amount": "mg"},
    inputs={"dose": "mg/h"},
    outputs={"conc": "mg/L"},
    parameters=[
        engine.Parameter("k", 0.3, "1/h", (0.01, 5.0)),
        engine.Parameter("V", 10.0, "L", (1.0, 100.0)),
        engine.Parameter("r", 0.02, "(mg/L)^2", (1e-6, 10.0)),
    ],
)


@pytest.mark.parametrize("samples", [1, 2])
def test_neither_delay_is_more_free_than_the_other(samples):
    """A sensor's, whose share went up to 1.5, fitted the noise by 1.02, gained 2.6 by it, and got the name."""
    rng = np.random.default_rng(7)
    u = np.repeat(rng.uniform(0.0, 80.0, 9), 15)
    u[:5] = 0.0
    came = np.concatenate([np.zeros(samples), u[:-samples]])
    whole = engine.simulate(DRUG, None, len(u), rng, u=came, dt=0.25).series
    series = whole.replace(u=u[:, None])
    setting = setting_for(DRUG, series, np.asarray(DRUG.theta()))
    assert float(samples) in {latest for latest, *_ in make_effect("delay:conc", setting).probes}
    found = {}
    for name in ("delay_dose", "delay_conc"):
        model = extend(DRUG, [name.replace("_", ":")], setting)
        start = {name: samples + 0.02, f"{name}_samples": float(samples)}
        start |= {p.name: 0.0 for p in model.parameters if p.name.endswith("_spread")}
        found[name] = quasi_ml(model, series, model.theta(start), ["k", "V", "r", name])
        assert found[name].theta[name] == pytest.approx(samples, abs=0.1)
    of_input, of_sensor = (one.log_likelihood for one in found.values())
    assert of_sensor == pytest.approx(of_input, abs=0.05)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_an_input_that_was_off_until_the_record_may_be_late(seed):
    """Switched on in the first row, it was held for what it is there, or anything, and the sensor was named."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(20.0, 80.0, 12), 10)
    came = np.concatenate([np.zeros(3), u[:-3]])
    series = engine.simulate(DRUG, None, len(u), rng, u=came, dt=0.25).series.replace(u=u[:, None])
    found = diagnose(DRUG, series, effects=["delay"], held_out=0, processes=1)
    assert found.verdict.value == "set"
    (cause,) = found.causes
    assert set(cause.equivalent) == {"delay:dose", "delay:conc"}
    assert cause.size == pytest.approx(3.0, abs=0.1)
    late = next(one for one in found.search.rounds[0].refits if one.effect.name == "delay:dose")
    assert late.fit.theta["delay_dose_before"] == 0.0


def test_what_has_no_zero_was_never_off():
    """A temperature of 0 degC before the record is no better a guess than one of 0 degF."""
    series = engine.simulate(DRUG, None, 30, 1, u=np.full(30, 20.0), dt=0.25).series
    setting = setting_for(DRUG, series, np.asarray(DRUG.theta()))
    kinds = ("delay:dose", "slow-input:dose", "path:dose->amount")
    assert all(make_effect(name, setting).before is not None for name in kinds)
    afloat = replace(setting, zeros={}, afloat=frozenset({"dose"}))
    assert all(make_effect(name, afloat).before is None for name in kinds)
