"""Looking back at what was found is bounded, however little noise there is: counted in iterations."""

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.diagnose.effects.hide import hide
from engine.diagnose.judging.verdict import cause_of
from engine.diagnose.refits import joint_refit
from engine.diagnose.refits.checkpoint import Kept
from engine.diagnose.search.pipeline import find_causes

KINDS = ("cubic", "drag", "force", "bias")


@pytest.fixture(scope="module")
def record():
    """An oscillator with two effects and nearly no noise, its model stepping more finely than its samples."""
    model, rng = engine.get_model("oscillator"), np.random.default_rng(4)
    names = ("force:velocity", "cubic:position->velocity")
    values = {"force_velocity": 2.0, "cubic_position__velocity": -30.0}
    theta = {"sigma_v": 1e-3, "sigma_y": 3e-4}
    u = np.repeat(rng.uniform(-0.5, 0.5, 15), 10)
    series = hide(model, names, values, 150, rng, theta=theta, u=u, dt=0.02).series
    return model, series.refined(4), theta


@pytest.fixture(scope="module")
def parts():
    """Of the diagnosis of that record: its rounds are searched once."""
    return {}


@pytest.fixture
def looked_back(record, parts, monkeypatch):
    """Causes of the record, looked back at anew, and the fits of that."""
    fits, fitted = [], joint_refit.quasi_ml

    def counting(*args, **kwargs):
        fits.append(fitted(*args, **kwargs))
        return fits[-1]

    def look():
        for name in [name for name in parts if name.startswith(("looking back", "finally"))]:
            del parts[name]
        model, series, theta = record
        found = find_causes(model, series, theta, seed=1, effects=KINDS, kept=Kept(parts))
        return [one for one in found.search.rounds if one.equivalent], found, fits

    monkeypatch.setattr(joint_refit, "quasi_ml", counting)
    # another beginning would look back, too
    monkeypatch.setattr(
        import_module("engine.diagnose.search.search"), "may_begin_otherwise", lambda *_: False
    )
    return look


def test_what_is_seen_only_beside_later_effects_is_weighed_where_it_may_lead():
    """The most promising two, from where the screen sees them; neither outliers nor what is known."""

    def score(name, statistic, **traits):
        usual = {"outliers": False, "unnamed": False}
        own = tuple(SimpleNamespace(name=f"{name}{part}") for part in ("", "_width"))
        effect = SimpleNamespace(
            name=name, traits=SimpleNamespace(**usual | traits), parameters=own
        )
        return SimpleNamespace(effect=effect, statistic=statistic, size=0.5, at=(2.0,))

    seen = SimpleNamespace(
        scores=[
            score("drag", 80.0),
            score("cubic", 70.0),
            score("square", 90.0),
            score("known", 200.0),
            score("tails", 200.0, outliers=True),
            score("force", 200.0, unnamed=True),
        ]
    )
    found = joint_refit._newcomers(seen, {"known"}, 100.0, {"k": 3.0})
    assert [effect.name for effect, _ in found] == ["square", "drag"]
    assert found[1][1] == {"k": 3.0, "drag": 0.5, "drag_width": 2.0}
    assert joint_refit._newcomers(seen, {"known"}, 500.0, {}) == []


@pytest.mark.slow
def test_refits_start_where_they_are_likely(looked_back):
    """Not where noise that is next to nothing has to explain a whole effect: that is a long climb."""
    rounds, found, fits = looked_back()
    assert [one.refits[0].effect.kind for one in rounds] == ["cubic", "force"]
    assert not found.search.unweighed
    assert all(fit.converged for fit in fits)
    assert sum(fit.iterations for fit in fits) < 5 * len(fits)


@pytest.mark.slow
def test_a_spent_budget_leaves_rounds_as_they_were_found(looked_back, monkeypatch):
    monkeypatch.setattr(joint_refit, "BUDGET", 4)
    rounds, found, fits = looked_back()
    names = tuple(one.refits[0].effect.name for one in rounds)
    assert found.search.unweighed == names == ("cubic:position->velocity", "force:velocity")
    assert sum(fit.iterations for fit in fits) <= 4
    assert any("Not compared" in note and names[1] in note for note in found.notes)


@pytest.mark.slow
def test_a_refit_that_was_cut_off_rules_nothing_out(looked_back, monkeypatch):
    monkeypatch.setattr(joint_refit, "ITERATIONS", 1)
    rounds, _, fits = looked_back()
    assert any(not fit.converged for fit in fits)
    for one in rounds:
        cut_off = {r.effect.name for r in one.refits if not r.fit.converged}
        assert not any(
            alike.ruled_out for alike in cause_of(one).look_alikes if alike.effect in cut_off
        )


@pytest.mark.long
def test_a_start_that_cannot_be_followed_comes_last(record):
    """Whether its likelihood is no number or the model refuses it; then a rival was silently left out."""
    base, series, _ = record

    def measurement(a, u, t, theta):
        if np.any(np.asarray(theta.sigma_y) == 0.5):
            raise ValueError("not this one")
        return a[:, :1], [[0.0]], [[theta.sigma_y**2]]

    model = replace(base, measurement=measurement)
    here, likelier, lost, refused = (
        model.theta({"sigma_y": 0.1, "sigma_v": v}) for v in (1.0, 10.0, 1.0, 1.0)
    )
    lost[model.index("sigma_y")], refused[model.index("sigma_y")] = np.nan, 0.5
    for starts in ((lost, here), (refused, here), (here, refused), (refused, here, likelier)):
        found = joint_refit._likeliest(model, series, np.array(starts))
        np.testing.assert_array_equal(found, likelier if len(starts) == 3 else here)
