"""A reading that comes late on a record with little noise: the length is found from probe to probe."""

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits.refit import refit
from engine.diagnose.screening.screening import screen_effects
from engine.estimation.quasi_ml import quasi_ml

LATE = 4  # samples


def exchanger():
    """The outlet of a heat exchanger, in degC: its rate grows with the flow."""

    def dynamics(a, u, t, dt, th):
        T = a[:, 0]
        rate = u[0] / th.m * (u[1] - T) + th.ua * (u[0] / 10.0) ** 0.6 / th.m * (80.0 - T)
        return [T + dt * rate], np.zeros((1, 0)), [[dt * th.s**2]]

    return engine.MixedModel(
        name="exchanger",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[th.r**2]]),
        initial=lambda th: (engine.Gaussian([40.0], [[100.0]]), [], np.zeros((0, 0))),
        nonlinear={"T": "degC"},
        inputs={"flow": "kg/min", "inlet": "degC"},
        outputs={"outlet": "degC"},
        parameters=[
            engine.Parameter("m", 20.0, "kg", (1.0, 200.0)),
            engine.Parameter("ua", 5.0, "kg/min", (0.1, 100.0)),
            engine.Parameter("s", 0.2, "K/min^0.5", (1e-4, 5.0)),
            engine.Parameter("r", 0.2, "K", (1e-3, 5.0)),
        ],
    )


@pytest.fixture(scope="module")
def late():
    """The record and the fit of the model that knows no delay."""
    rng = np.random.default_rng(2)
    flow = np.repeat(rng.uniform(5.0, 15.0, 16), 30)
    inlet = np.repeat(rng.uniform(15.0, 25.0, 12), 40)
    truth = {"m": 15.0, "ua": 8.0, "s": 0.1, "r": 1e-3}
    u = np.column_stack([flow, inlet])
    T = engine.simulate(exchanger(), truth, 480, rng, u=u, dt=0.2).series.y[:, 0]
    y = np.concatenate([np.full(LATE, T[0]), T[:-LATE]]) + 0.1 * rng.standard_normal(480)
    series = engine.Series(y=y, u=u, dt=0.2)
    return series, quasi_ml(exchanger(), series)


@pytest.mark.long
def test_a_refit_ends_at_the_length_that_is_likeliest(late):
    series, fit = late
    setting = setting_for(fit.model, series, np.asarray(fit.theta))
    seen = screen_effects(fit, series, setting, ["delay"], 0.05, 0, lambda stage, share: None)
    score = next(s for s in seen.scores if s.effect.name == "delay:outlet")
    found = refit(fit, series, score)
    assert found.size == pytest.approx(LATE, abs=0.2)
    model = make_effect("delay:outlet", setting).apply(fit.model)
    for samples in (LATE + 1, LATE + 2):
        start = {"m": 15.0, "ua": 8.0, "s": 0.1, "r": 0.1, "delay_outlet": float(LATE)}
        start["delay_outlet_samples"] = samples
        other = quasi_ml(model, series, start, [*fit.free, "delay_outlet"])
        assert other.log_likelihood < found.fit.log_likelihood - 20.0
