"""A characteristic that one of several records calls for, and the others do not, is none."""

from types import SimpleNamespace as Some

import numpy as np
import pytest

import engine
from engine.data.series import Series
from engine.diagnose import extend
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.free_run.answer import FreeRunSearch, only_one
from engine.diagnose.free_run.second_opinion import _of_one_record
from engine.diagnose.free_run_fits.candidates import fit_of
from engine.diagnose.free_run_fits.fitted import fit_runs
from engine.diagnose.judging.findings import Verdict
from engine.estimation.quasi_ml import quasi_ml

VALUES = {"tau": 25.0, "k": 0.06, "q": 1e-3, "r": 0.04}


def kettle():
    """A temperature above the room's, heated and cooling: T' = -T / tau + k P."""

    def dynamics(a, u, t, dt, theta):
        kept = np.exp(-dt / theta.tau)
        return [(1.0 - kept) * theta.tau * theta.k * u[0]], [[kept]], [[theta.q]]

    return engine.MixedModel(
        name="kettle",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
        initial=lambda theta: (None, [0.0], [[1.0]]),
        linear={"T": "K"},
        inputs={"P": "W"},
        outputs={"reading": "K"},
        parameters=[
            engine.Parameter("tau", 20.0, "s", (1.0, 1000.0)),
            engine.Parameter("k", 0.05, "K/J", (0.0, 10.0)),
            engine.Parameter("q", 1e-3, "K^2", (0.0, 10.0)),
            engine.Parameter("r", 0.04, "K^2", (1e-8, 100.0)),
        ],
    )


KETTLE = kettle()


def heated(n, seed, step=0.0, drag=0.0):
    """A record from t = 0 on; its reading steps at row 90, or heat is lost faster the hotter it is."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.0, 20.0, -(-n // 20)), 20)[:n]
    y, T, kept = np.empty(n), 0.0, np.exp(-1.0 / 25.0)
    for i in range(n):
        y[i] = T + step * (i >= 90) + 0.2 * rng.standard_normal()
        T = kept * T + (1.0 - kept) * 25.0 * 0.06 * u[i] - drag * T * abs(T)
        T += np.sqrt(1e-3) * rng.standard_normal()
    return Series(y, u, dt=1.0, y_names=["reading"], u_names=["P"])


def fits(records, effect, size):
    """The free runs without and with an effect, fitted to all records."""
    base = quasi_ml(KETTLE, records, VALUES, max_iterations=3)
    before = fit_of(base, records)
    setting = setting_for(KETTLE, records[0], np.asarray(before.theta))
    model = extend(KETTLE, [effect], setting)
    values = model.theta().asdict() | before.theta.asdict()
    name = model.parameter_names[len(KETTLE.parameter_names)]
    free = [*before.free, name]
    return before, fit_runs(model, records, model.theta(values | {name: size}), free, before.x1)


@pytest.mark.parametrize("effect", ["cubic-sensor:reading", "drag:T"])
def test_what_came_once_in_one_record_is_no_characteristic(effect):
    records = [heated(200, 1), heated(160, 2, step=2.0), heated(120, 3)]
    before, after = fits(records, effect, 1e-4)
    assert after.cost < 0.99 * before.cost
    assert only_one(before, after) is records[1]
    assert "160 samples from t = 0 s on" in _of_one_record(records[1])


def test_what_all_records_call_for_is_one():
    records = [heated(n, n, drag=4e-3) for n in (200, 160, 120)]
    assert only_one(*fits(records, "drag:T", 1e-3)) is None


def test_what_one_record_alone_calls_for_is_not_named():
    fit = Some(rms=1.0)
    last = Some(chosen=None, survivors=(), alarmed=False)
    first = Some(chosen=Some(fit=fit, added=()), survivors=((),), fit=fit)
    assert FreeRunSearch((first, last), (None, None), (0.5, 0.0)).verdict is Verdict.NAMED
    found = FreeRunSearch((first, last), (None, None), (0.5, 0.0), alone=heated(60, 1))
    assert found.verdict is Verdict.UNKNOWN
