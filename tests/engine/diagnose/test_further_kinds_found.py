"""Kinds that engineers meet, hidden in the shipped models and found with the whole catalogue open."""

import numpy as np
import pytest

import engine
from engine.diagnose.effects.hide import hide
from engine.estimation.quasi_ml import quasi_ml

T = 500


def hidden_in(model, name, own, lowest, highest, dt):
    rng = np.random.default_rng(1)
    held = 20 if model.name == "tanks" else 10
    u = np.repeat(rng.uniform(lowest, highest, T // held), held)
    return hide(model, [name], own, T, rng, u=u, dt=dt).series


@pytest.mark.slow
def test_a_tank_that_overflows_into_the_next_is_in_the_set():
    """The upper level is not measured: limit and share are told by the lower one.

    An outlet that depends on the pump has two parameters less, and says nearly as much of this record.
    """
    model = engine.get_model("tanks")
    name = "overflow_upper__lower"
    own = {name: 0.5, f"{name}_limit": 5.0, f"{name}_share": 0.5}
    series = hidden_in(model, "overflow:upper->lower", own, 1.0, 4.5, 4.0)
    found = engine.diagnose(model, series, seed=1)
    (cause,) = found.causes
    assert "overflow:upper->lower" in cause.equivalent
    (overflow,) = (
        r for r in found.search.rounds[0].refits if r.effect.name == "overflow:upper->lower"
    )
    assert overflow.fit.theta[f"{name}_share"] == pytest.approx(0.5, abs=0.2)
    # this record hardly tells a low limit from a weak overflow; nothing near the truth is more likely
    searched = series.part(0, int(0.8 * T)).refined(found.substeps)
    from_truth = quasi_ml(
        overflow.fit.model, searched, overflow.fit.model.theta(own), overflow.fit.free
    )
    assert overflow.fit.log_likelihood > from_truth.log_likelihood - 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "own"),
    [
        ("direct:drive->y", {"direct_drive__y": 0.05}),
        ("path:drive->y", {"path_drive__y": 0.1, "path_drive__y_time": 1.5}),
    ],
)
def test_a_further_way_of_the_input_is_found(name, own):
    model = engine.get_model("oscillator")
    series = hidden_in(model, name, own, -1.0, 1.0, 0.05)
    found = engine.diagnose(model, series, seed=1)
    assert [cause.effect for cause in found.causes] == [name]
    for key, value in own.items():
        assert found.causes[0].parameters[key] == pytest.approx(value, rel=0.15)
