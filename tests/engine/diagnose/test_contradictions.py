"""A name that something contradicts is not said."""

from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.judging import contradictions, judgement
from engine.diagnose.judging.contradictions import (
    already_there,
    as_open,
    folded,
    particle_word,
    undetermined,
)
from engine.diagnose.judging.verdict import _look_alikes
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.search.pipeline import find_causes
from engine.estimation.quasi_ml import QuasiFit
from tests.engine.hidden_effects import DRIVE, hidden


def found(name, size, error, second=None):
    """A round whose choice has this size and standard error."""
    effect = make_effect(name, Setting(DRIVE))
    model = effect.apply(DRIVE)
    free = [effect.size.name] if second is None else [effect.size.name, effect.parameters[1].name]
    theta = model.theta({free[0]: size} if second is None else {free[0]: size, free[1]: second})
    fit = QuasiFit(model, theta, 0.0, tuple(free), np.eye(len(free)) / error**2, 1, True)
    return SimpleNamespace(refits=(Refit(effect, fit, 40.0, 40.0),))


# a fit of two parameters, each determined by itself
NO_TIES = QuasiFit(DRIVE, DRIVE.theta(), 0.0, ("damping", "load"), np.eye(2), 1, True)


@pytest.mark.parametrize(
    ("rhos", "said"),
    [
        ((0.4, 0.3), []),
        ((0.4, 1e-12), ["direct:force->reading"]),  # the model's own term
        ((0.4, 0.0), []),  # nothing that excites it, then
    ],
)
def test_a_term_of_the_model_is_no_second_cause(rhos, said):
    """A direct path that the model has shows beside a bent sensor: so the sensor is not what is bent."""
    effects = [make_effect(n, Setting(DRIVE)) for n in ("cubic-sensor:reading", "bias:reading")]
    effects[1] = SimpleNamespace(name="direct:force->reading")
    scores = [SimpleNamespace(effect=e, rho=rho) for e, rho in zip(effects, rhos, strict=True)]
    screen = SimpleNamespace(scores=scores)
    rounds = [SimpleNamespace(screen=screen, refits=(SimpleNamespace(effect=e),)) for e in effects]
    told = already_there(rounds)
    assert list(told) == said
    assert all("cubic-sensor:reading" in text for text in told.values())
    assert not already_there(rounds[1:])  # alone it is none of the model's


@pytest.mark.parametrize(
    ("name", "size", "error", "second", "said"),
    [
        ("drag:speed", 1.0, 0.4, None, False),
        ("drag:speed", 1.0, 0.6, None, True),
        ("drag:speed", -1.0, 0.6, None, True),
        ("harmonic:speed", 0.01, 0.2, 1.0, False),  # its sine is what there is
        ("harmonic:speed", 0.01, 0.2, 0.1, True),
        ("colored:reading", 1.0, 0.6, None, False),  # a variance: its error is no Gaussian one
    ],
)
def test_a_size_that_may_as_well_be_zero_is_no_finding(name, size, error, second, said):
    texts = undetermined([found(name, size, error, second)], NO_TIES)
    assert bool(texts) is said
    assert all(name in text for text in texts)


def beside(names, values, covariance):
    """A fit of parameters of the drive, and of the size of a drag if it is among them, with this covariance."""
    model = make_effect("drag:speed", Setting(DRIVE)).apply(DRIVE)
    theta = model.theta(dict(zip(names, values, strict=True)))
    return QuasiFit(model, theta, 0.0, names, np.linalg.inv(covariance), 1, True)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (
            0.6,
            0.6,
            False,
        ),  # half the damping and half the drag predict the same, as half of it did before
        (0.6, 1e4, False),  # the same, the errors beyond any number
        (0.1, 0.6, True),  # a damping that was known: the drag may take its place
    ],
)
def test_a_size_as_open_as_a_parameter_was_before_is_not_undetermined(before, after, said):
    noise = 1e-3 * np.eye(2)
    base = beside(("damping", "load"), (1.0, 2.0), np.diag([before**2, 0.01]))
    together = after**2 * np.ones((2, 2)) + noise
    fit = beside(("damping", "drag_speed"), (1.0, 1.0), together)
    effect = make_effect("drag:speed", Setting(DRIVE))
    rounds = [SimpleNamespace(refits=(Refit(effect, fit, 40.0, 40.0),))]
    assert bool(undetermined(rounds, base)) is said
    assert ["damping" in text for text in as_open(rounds, base)] == [True] * (not said)


@pytest.mark.slow
def test_an_undetermined_size_makes_the_verdict_unknown(monkeypatch):
    series = hidden(["bias:reading"], {"bias_reading": 0.5}, 1)
    named = find_causes(DRIVE, series, effects=["bias"], seed=1)
    assert named.verdict.value == "named"
    monkeypatch.setattr(judgement, "undetermined", lambda rounds, base: ["because"])
    again = find_causes(DRIVE, series, effects=["bias"], seed=1)
    assert again.verdict.value == "unknown"
    assert "because" in again.notes


def word(monkeypatch, gains, moment):
    """The word of a particle filter that sees such gains with 500 and with 2000 particles."""
    seen = []

    def gain(before, after, series, particles, seed):
        seen.append(particles)
        return gains[len(seen) - 1]

    monkeypatch.setattr(contradictions, "_particle_gain", gain)
    text, contradicts = particle_word(None, None, moment, None, 0)
    return seen, text, contradicts


@pytest.mark.parametrize(
    ("gains", "moment", "runs", "contradicts"),
    [
        ([(21.0, 1.0)], 20.0, 1, False),
        ([(14.0, 0.5)], 20.0, 1, False),  # less, but most of it
        ([(-789.0, 220.0), (600.0, 20.0)], 631.0, 2, False),  # more particles say otherwise
        ([(-789.0, 220.0), (-700.0, 100.0)], 631.0, 2, True),
        ([(-1.5e50, 1.5e50)], 631.0, 1, False),  # tells nothing
        ([(np.nan, np.nan)], 631.0, 1, False),  # lost: no word at all
    ],
)
def test_the_particle_filter_may_contradict(monkeypatch, gains, moment, runs, contradicts):
    seen, text, said = word(monkeypatch, gains, moment)
    assert len(seen) == runs
    assert said is contradicts
    assert text


def test_a_particle_filter_that_scatters_widely_has_no_figure(monkeypatch):
    """On readings nearly free of noise it once said -1.5e50 +- 1.5e50, in all digits."""
    _, text, _ = word(monkeypatch, [(-1.5e50, 1.5e50)], 631.0)
    assert "631.0" in text
    assert "does not tell" in text
    assert "0000" not in text


@pytest.mark.long
def test_a_contradiction_makes_the_verdict_unknown(monkeypatch):
    series = hidden(["bias:reading"], {"bias_reading": 0.5}, 1)
    asked = {"effects": ["bias"], "seed": 1}
    assert engine.diagnose(DRIVE, series, **asked).verdict.value == "named"
    held_out = import_module("engine.diagnose.held_out")
    monkeypatch.setattr(held_out, "particle_word", lambda *a: ("No gain.", True))
    doubted = engine.diagnose(DRIVE, series, **asked)
    assert doubted.verdict.value == "unknown"
    assert "No gain." in doubted.notes
    assert doubted.why == ("No gain.",)


def test_a_plainer_name_that_is_not_ruled_out_is_listed_however_much_others_gain():
    """A drift was the truth, and not on the list: steps with a time to choose gain more, and cost more."""
    setting = Setting(DRIVE)
    gains = {
        "step:reading": (46.5, 40.0), "episode:reading": (52.0, 39.0), "step:speed": (45.9, 39.4),
        "episode:speed": (52.0, 38.9), "pulse:reading": (45.0, 38.5), "pulse:speed": (44.0, 37.5),
        "cubic:speed": (20.0, 20.0), "drift:reading": (37.4, 37.4),
    }  # fmt: skip
    effects = [make_effect(name, setting) for name in gains]
    scores = tuple(SimpleNamespace(effect=e, statistic=30.0) for e in effects)
    refits = [
        SimpleNamespace(effect=e, gain=gain, score=score, fit=SimpleNamespace(given_up=False))
        for e, (gain, score) in zip(effects, gains.values(), strict=True)
    ]
    one = SimpleNamespace(
        screen=SimpleNamespace(scores=scores, likeness=lambda i, j: 0.9),
        refits=tuple(refits), equivalent=(refits[0],), generic=None, contradicted=(),
    )  # fmt: skip
    told = _look_alikes(one, refits[0])
    assert {x.effect for x in told} == {*gains} - {"step:reading", "cubic:speed"}
    assert not any(x.ruled_out for x in told)
    assert told[0].effect == "step:speed"  # the likeliest
    refits[1].score = refits[1].gain = (
        25.0  # and of those that are ruled out only as many as before
    )
    assert "episode:reading" not in {x.effect for x in _look_alikes(one, refits[0])}


def test_only_a_refit_that_has_ended_can_be_ruled_out():
    setting = Setting(DRIVE)
    kinds = ["drag:speed", "cubic:speed", "coulomb:speed"]
    effects = [make_effect(name, setting) for name in kinds]
    scores = tuple(SimpleNamespace(effect=e, statistic=30.0) for e in effects)
    screen = SimpleNamespace(scores=scores, likeness=lambda i, j: 0.9)
    refits = [
        SimpleNamespace(effect=e, score=s, gain=s, fit=SimpleNamespace(given_up=g))
        for e, s, g in zip(effects[:2], (40.0, 20.0), (False, True), strict=True)
    ]
    one = SimpleNamespace(
        screen=screen,
        refits=tuple(refits),
        equivalent=(refits[0],),
        generic=None,
        contradicted=(),
    )
    ruled_out = {x.effect: x.ruled_out for x in _look_alikes(one, refits[0])}
    assert ruled_out == {"cubic:speed": False, "coulomb:speed": False}
    refits[1].fit.given_up = False
    ruled_out = {x.effect: x.ruled_out for x in _look_alikes(one, refits[0])}
    assert ruled_out == {"cubic:speed": True, "coulomb:speed": False}
    refits[1].score = refits[1].gain = 37.0  # e^(3 / 2) times as likely is not much
    told = {x.effect: x for x in _look_alikes(one, refits[0])}["cubic:speed"]
    assert not told.ruled_out
    assert told.difference == "is less likely, by a factor of 4.5, too little to rule it out"
    refits[1].score = refits[1].gain = 50.0  # ahead in its round, beaten with what was found later
    told = {x.effect: x for x in _look_alikes(one, refits[0])}["cubic:speed"]
    assert not told.ruled_out
    assert told.difference == "was likelier before what was found beside the cause"


def test_outliers_of_a_state_that_were_a_little_likelier_are_not_the_same_in_other_words():
    """The search goes on with those of a reading where, with what is found beside them, they do better."""
    setting = Setting(DRIVE)
    effects = [make_effect(f"heavy-tails:{name}", setting) for name in ("reading", "speed")]
    scores = tuple(SimpleNamespace(effect=e, statistic=30.0) for e in effects)
    fit = SimpleNamespace(given_up=False)
    refits = [
        SimpleNamespace(effect=e, score=s, gain=s, fit=fit)
        for e, s in zip(effects, (248.91, 250.27), strict=True)
    ]
    one = SimpleNamespace(
        screen=SimpleNamespace(scores=scores, likeness=lambda i, j: 0.9),
        refits=tuple(refits),
        equivalent=(refits[0],),
        generic=None,
        contradicted=(),
    )
    (told,) = _look_alikes(one, refits[0])
    assert told.difference == "was likelier before what was found beside the cause"
    one.equivalent = tuple(refits)
    (told,) = _look_alikes(one, refits[0])
    assert not told.difference.startswith("was likelier")


def test_a_model_far_from_the_data_has_no_named_cause():
    """Its noise is held at a tenth of what is there."""
    known = engine.get_model("local-level")
    rng = np.random.default_rng(3)
    series = engine.simulate(known, {"q": 1.0, "r": 1.0, "level": 0.0}, 150, rng).series
    found = find_causes(
        known, series, {"q": 0.01, "r": 0.01, "level": 0.0}, free=["level"], effects=["bias"]
    )
    assert found.verdict.value == "unknown"
    fits = find_causes(
        known, series, {"q": 1.0, "r": 1.0, "level": 0.0}, free=["level"], effects=["bias"]
    )
    assert fits.verdict.value == "nothing"


def test_a_scattering_particle_filter_is_no_contradiction():
    """Its log-likelihood is log-normal's: too low by half the variance, and that is known badly."""
    rng = np.random.default_rng(4)
    inside, low = 0, 0
    for _ in range(200):
        after = 30.0 - 0.5 * 8.0**2 + 8.0 * rng.standard_normal(4)
        before = -0.5 * 0.5**2 + 0.5 * rng.standard_normal(4)
        values = np.stack([before, after], axis=1)
        gain, error = contradictions.debiased(values)
        inside += abs(gain - 30.0) < 3.0 * error
        low += abs((after - before).mean() - 30.0) > 3.0 * (after - before).std(ddof=1) / 2.0
    assert low > 150  # the mean alone is far from the truth
    assert inside > 160  # four runs know their variance badly


def test_a_quiet_particle_filter_is_believed():
    values = np.array([[-5.0, 2.0], [-5.1, 2.1], [-4.9, 1.9], [-5.0, 2.0]])
    gain, error = contradictions.debiased(values)
    assert gain == pytest.approx(7.0, abs=0.02)
    assert error < 0.15


@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_a_sensors_curve_that_turns_back_within_the_readings_is_no_sensors(unit):
    """Its runs turn over: such a one was named of a street whose air held more than it could have read."""
    y = np.linspace(-2.0, 2.0, 200) * unit
    series = engine.Series(y, np.ones(200), dt=0.1, y_names=["reading"], u_names=["force"])
    setting = Setting(DRIVE, zeros={"reading": 0.0})
    effect = make_effect("cubic-sensor:reading", setting)
    extended = effect.apply(DRIVE)

    def said(size):
        theta = extended.theta({effect.size.name: size / unit**2})
        fit = SimpleNamespace(theta=theta, model=extended)
        return folded([SimpleNamespace(refits=[Refit(effect, fit, 50.0, 50.0)])], series, setting)

    (sentence,) = said(-0.3)  # it turns at 1.054, at 0.703 of its reading
    assert f"{(np.abs(y) > 1.1 * 0.7027 * unit).sum()} readings lie beyond" in sentence
    assert said(-0.03) == []  # at 3.3, and so at 2.2 of its reading
    assert said(0.3) == []  # never
