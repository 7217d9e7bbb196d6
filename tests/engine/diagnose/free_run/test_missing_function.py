"""A force that no effect of the catalogue describes: found where it acts, its curve, and told on every page."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import engine
from engine.data.series import Series
from engine.diagnose.effects.free_function import free_function, hats, knots_of
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.answer import best_runs, search_free_runs, setting_of
from engine.diagnose.free_run.missing_function import missing_function
from engine.diagnose.free_run.search import GAINED
from engine.diagnose.free_run_fits.folds import folds_of, losses
from engine.diagnose.judging.findings import Verdict
from engine.estimation.quasi_ml import quasi_ml
from engine.models.local_level import MODEL as LEVEL
from tests.engine.clear_step import clear_flows
from tests.engine.diagnose.free_run.test_other_models import DT, cart
from tests.engine.plain_models import room

FREE = ["k", "c", "gain", "q"]
T = 300


def hidden(x):
    """Metres to metres per second squared: a magnet on the way."""
    return 3.0 * np.exp(-(((x - 0.3) / 0.6) ** 2))


@cache
def _readings(strength):
    """The cart's own equations with the force in them, in metres."""
    rng = np.random.default_rng(1)
    u = 4.0 * np.repeat(rng.standard_normal((T // 10, 1)), 10, axis=0)
    y, x, v = np.zeros(T), 1.5, 0.0
    for i in range(T):
        y[i] = x
        v += DT * (-9.0 * x - 0.3 * v + u[i, 0] + strength * hidden(x))
        x += DT * v
    return y + 1e-3 * rng.standard_normal(T), u


@cache
def _fit(unit, zero, strength):
    y, u = _readings(strength)
    model, series = cart(unit, zero, inputs=1), Series(y / unit + zero, u, dt=DT)
    base = quasi_ml(model, series, model.theta(), FREE)
    return best_runs(model, [series], [base.theta, model.theta()], base.free, 1)


@cache
def _missing(unit, zero, strength):
    fit = _fit(unit, zero, strength)
    return missing_function(
        fit, losses(fit, folds_of(fit.records)), setting_of(fit, (), fit.records)
    )


@pytest.mark.long
@pytest.mark.parametrize(("unit", "zero"), [(1.0, 0.0), (1e-6, 3e5)])
def test_a_force_without_a_name_is_found_with_its_curve_in_any_unit(unit, zero):
    found = _missing(unit, zero, 1.0)
    assert (found.source, found.target) == ("position", "rate")
    assert found.left < 0.5
    assert found.p_value <= GAINED  # beyond the range of a fold its curve is anyone's guess
    x, mean, sd = (found.x - zero) * unit, found.mean * unit, found.sd * unit
    straight = np.stack((x, np.ones_like(x)), axis=1) / sd[:, None]  # the spring's and its zero's
    off = (hidden(x) - mean) / sd
    off -= straight @ np.linalg.lstsq(straight, off, rcond=None)[0]
    assert np.sqrt(np.mean(off**2)) < 3.0
    assert x[np.argmax(mean)] == pytest.approx(0.3, abs=0.2)


@pytest.mark.slow
def test_it_is_not_found_where_nothing_is_missing():
    assert _missing(1.0, 0.0, 0.0) is None


@pytest.mark.slow
def test_where_no_name_does_nearly_as_well_the_answer_is_unknown_with_the_curve():
    fit = _fit(1.0, 0.0, 1.0)
    y, u = _readings(1.0)
    model, series = cart(inputs=1), Series(y, u, dt=DT)
    base = quasi_ml(model, series, fit.theta, FREE, max_iterations=0)
    found = search_free_runs(
        base,
        [series],
        fit.theta,
        levels=(1.0, 1.0),  # whatever noise explains
        kinds=("drag", "bias"),
        seed=1,
        progress=lambda stage, fraction: None,
    )
    assert found.missing is not None
    assert found.missing.source == "position"
    assert found.verdict is Verdict.UNKNOWN


def test_the_hats_of_knots_share_one_between_them_everywhere():
    rng = np.random.default_rng(0)
    values = rng.standard_normal(500) ** 3
    knots = knots_of(values)
    assert len(knots) > 3
    assert (np.diff(knots) > 0.0).all()
    at = np.linspace(values.min() - 1.0, values.max() + 1.0, 97)
    parts = hats(at, knots)
    assert np.allclose(parts.sum(axis=0), 1.0, atol=1e-12)
    assert (parts >= 0.0).all()
    assert np.array_equal(hats(knots, knots), np.eye(len(knots)))


@pytest.mark.parametrize("each", [False, True])
def test_a_free_function_is_the_sum_of_its_hats(each):
    """At numbers, and at parameters of each row's own; beyond the knots it is level."""
    model, rng = room(), np.random.default_rng(1)
    knots, directions = np.array([15.0, 18.0, 19.0, 25.0]), rng.standard_normal((4, 2))
    effect = free_function(Setting(model), "air", "air", knots, directions)
    extended, a = effect.apply(model), rng.uniform(10.0, 30.0, (12, 1))
    sizes = rng.standard_normal((12 if each else 1, 2))
    thetas = np.hstack([np.tile(model.theta(), (len(sizes), 1)), sizes])
    record = extended.records(thetas) if each else extended.record(thetas[0])
    u = np.array([1.0, 10.0])
    base = model.transition(a, u, 0.0, 0.5, model.record(model.theta()))[0]
    pushed = extended.transition(a, u, 0.0, 0.5, record)[0] - base
    values = hats(a[:, 0], knots).T @ directions
    np.testing.assert_allclose(pushed[:, 0], 0.5 * (values * sizes).sum(axis=1), rtol=1e-9)
    assert not pushed[:, 1].any()


def test_a_signal_that_stands_still_has_no_curve():
    assert len(knots_of(np.full(30, 2.0))) == 1
    assert len(knots_of(np.full(3, np.nan))) == 1


@pytest.mark.long
def test_the_curve_is_on_the_page_in_the_document_and_in_the_report(tmp_path):
    plain = engine.diagnose(LEVEL, clear_flows(), effects=["step"])
    missing = _missing(1.0, 0.0, 1.0)
    found = replace(plain, free_run=replace(plain.free_run, missing=missing))
    assert "Some function of position" in " ".join(str(found).split())
    told = found.to_dict()["free_run"]["missing"]
    assert (told["source"], told["source_unit"], told["target"]) == ("position", "m", "rate")
    assert told["curve"]["mean"] == pytest.approx(missing.mean.tolist(), rel=1e-6)
    page = found.report(tmp_path / "report.html").read_text()
    assert "A function of position that acts on rate" in page
    assert "A function of" not in plain.report(tmp_path / "plain.html").read_text()
