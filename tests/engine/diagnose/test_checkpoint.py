"""A diagnosis that is stopped and goes on, as often as one likes: the same numbers, bit for bit."""

import json

import numpy as np
import pytest

import engine
from engine import diagnose
from engine.data import nile
from engine.data.series import Series
from engine.diagnose.effects import catalogue
from engine.diagnose.effects.hide import hide
from engine.diagnose.refits import checkpoint as keeping
from engine.diagnose.search import pipeline
from engine.errors import OptionError
from engine.presentation.report import report_html
from tests.engine.clear_step import clear_flows
from tests.engine.hidden_effects import DRIVE, levels

LEVEL = engine.get_model("local-level")


class Stopped(Exception):  # noqa: N818 - nothing has gone wrong
    """As Ctrl-C would."""


class StopsAfter(dict):
    """Takes so many parts, and stops the run with the last of them."""

    def __init__(self, parts, more):
        super().__init__(parts)
        self.left = more

    def __setitem__(self, name, value):
        assert name not in self, "nothing is computed twice"
        super().__setitem__(name, value)
        self.left -= 1
        if not self.left:
            raise Stopped


def drive(names, values, seed, n=240):
    rng = np.random.default_rng(seed)
    return hide(DRIVE, names, values, n, rng, u=levels(rng, n), dt=0.1).series


def two_effects():
    """A second round, and a look back at the first."""
    values = {"bias_reading": 0.5, "cubic_speed": -2.0}
    effects = ["bias:reading", "cubic:speed"]
    series = drive(effects, values, seed=5, n=160)
    return DRIVE, series, {"effects": effects, "seed": 1}


def outliers():
    """Readings are taken out before the second round."""
    values = {"heavy_tails_reading_share": 0.06, "heavy_tails_reading_ratio": 10.0}
    series = drive(["heavy-tails:reading"], values, seed=3)
    return DRIVE, series, {"effects": ["heavy-tails", "bias", "gain"], "seed": 1}


def swallowed():
    """The step is refitted before there is an alarm; the alarm's p-value again by simulation."""
    return LEVEL, nile(), {"effects": ["step", "pulse"], "seed": 1, "bootstrap": 4}


CASES = {"two effects": two_effects, "outliers": outliers, "swallowed, bootstrap": swallowed}


def numbers(found):
    """All that a diagnosis says, but how long it took."""
    told = found.to_dict()
    del told["seconds"]
    told["page"] = [line for line in told["page"].splitlines() if " s in all: " not in line]
    return json.dumps(told)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "steps"),
    [
        ("two effects", 1),
        ("two effects", 9),
        ("outliers", 4),
        ("swallowed, bootstrap", 5),
    ],
)
def test_stopped_after_every_few_parts(case, steps):
    model, series, options = CASES[case]()
    expected = diagnose(model, series, **options)
    assert expected.rounds[0].equivalent, "the case is of no use"
    kept, times = {}, 0
    while True:
        parts = StopsAfter(json.loads(json.dumps(kept)), steps)
        try:
            found = diagnose(model, series, **options, kept=parts)
            break
        except Stopped:
            kept, times = parts, times + 1
    assert times == len(parts) // steps
    assert numbers(found) == numbers(expected)
    spent = sum(part["seconds"] for part in parts.values() if "seconds" in part)
    assert sum(found.seconds.values()) > spent, "of all attempts together"
    kinds = {name.split(": ")[-1].split()[0] for name in parts}
    assert {"asked", "fit", "screen", "refit"} <= kinds
    if case == "two effects":
        assert any(name.startswith("looking back") for name in parts)
    if "bootstrap" in options:
        assert "bootstrap 4" in parts


STEP = {"effects": ["step"], "seed": 1}


@pytest.fixture(scope="module")
def parts_of_step():
    """What is kept of a diagnosis that was asked for with a number of NumPy, as JSON."""
    kept = {}
    diagnose(LEVEL, clear_flows(), **STEP | {"seed": np.int64(1)}, kept=kept)
    return json.dumps(kept)


@pytest.fixture
def kept(parts_of_step):
    return json.loads(parts_of_step)


@pytest.mark.long
def test_what_was_kept_of_another_diagnosis_is_refused(kept):
    flows = clear_flows()
    options = STEP | {"kept": kept}
    other = Series(flows.y + 1e-9, t=flows.t, y_names=flows.y_names)
    faster = engine.MixedModel(**{**vars_of(LEVEL), "measurement": twice})
    for model, series, more, what in (
        (LEVEL, other, {}, "another series"),
        (LEVEL, flows, {"test": flows.part(50, 100)}, "another test series"),
        (LEVEL, flows, {"seed": 2}, "other options"),
        (LEVEL, flows, {"effects": ["step", "pulse"]}, "other options"),
        (LEVEL, flows, {"theta": {LEVEL.parameter_names[0]: 1.0}}, "other options"),
        (faster, flows, {}, "another model"),
    ):
        with pytest.raises(OptionError, match=f"is of a diagnosis with {what}") as error:
            diagnose(model, series, **options | more)
        assert error.value.field == "kept"


@pytest.mark.long
def test_numbers_of_numpy_ask_for_the_same(kept, parts_of_step):
    diagnose(LEVEL, clear_flows(), **STEP, kept=kept)
    assert kept == json.loads(parts_of_step)


def test_what_another_version_kept_is_refused(monkeypatch, kept):
    monkeypatch.setattr(keeping, "version", lambda name: "0.0.1")
    with pytest.raises(OptionError, match="another version of rbps"):
        diagnose(LEVEL, clear_flows(), **STEP, kept=kept)


def test_another_catalogue_is_refused(monkeypatch, kept):
    monkeypatch.setitem(catalogue._makers, "new", catalogue._makers["step"])
    with pytest.raises(OptionError, match="another catalogue"):
        diagnose(LEVEL, clear_flows(), **STEP, kept=kept)


def vars_of(model):
    return {name: getattr(model, name) for name in model.__dataclass_fields__}


def twice(a, u, t, theta):
    """Another function under the same name."""
    h, C, R = LEVEL.measurement(a, u, t, theta)
    return h, 2.0 * np.asarray(C), R


# ---- what is known while the search goes on -----------------------------------------------------------------


@pytest.mark.slow
def test_it_tells_early_what_it_ends_with():
    """The fit and its symptoms before any effect is looked at; then the scores of the first screen."""
    model, series, options = two_effects()
    told, stages = [], []
    found = engine.diagnose(
        model, series, **options, early=lambda d: told.append((d, list(stages))),
        callback=lambda stage, share: stages.append(stage),
    )  # fmt: skip
    (first, before), (second, after) = told
    assert json.loads(json.dumps(told)) == [[d, s] for d, s in told]
    assert "screen" not in before
    assert "refit" not in after
    assert first["screen"] is None
    assert second == first | {"screen": second["screen"]}
    base = found.search.base
    assert first["log_likelihood"] == base.log_likelihood
    assert {k: v["value"] for k, v in first["estimate"].items()} == base.theta.asdict()
    ended = found.to_dict()
    assert first["symptoms"] == ended["symptoms"]
    assert first["sentences"] == ended["symptoms"]["sentences"]
    scores = found.rounds[0].screen.scores
    assert [s["effect"] for s in second["screen"]["scores"]] == [s.effect.name for s in scores[:8]]
    assert found.causes[0].effect in second["screen"]["sentence"]


def test_seconds_of_a_part_are_counted_once():
    """By the clock of the run that computes it; what an earlier run computed is added as it is taken up."""
    parts, told = {}, []
    first = keeping.Kept(parts, told.append)
    for where in (first, first.within("a round").apart("more"), first):
        assert where.numbers("a sum", lambda: 1.0) == 1.0
    assert not told
    second = keeping.Kept(parts, told.append)
    assert second.numbers("a sum", lambda: 2.0) == 1.0
    assert told == [parts["a sum"]["seconds"]]


@pytest.mark.long
def test_every_second_is_of_a_stage(monkeypatch):
    """Steps are chosen again for what was found: in the search, though all of it was kept."""
    clock = pipeline.Clock()
    monkeypatch.setattr(pipeline, "_steps", lambda *_: clock.spent(1.0) or 1)
    series = drive(["bias:reading"], {"bias_reading": 0.5}, seed=5, n=160)
    found = pipeline.find_causes(
        DRIVE, series, effects=["bias:reading"], max_effects=1, clock=clock
    )
    assert found.verdict.value == "named"
    assert list(clock.seconds) == ["fit", "search"]
    assert clock.seconds["search"] > 1.0


@pytest.mark.slow
def test_a_resumed_one_tells_the_same_early():
    model, series, options = two_effects()
    parts, told = {}, []
    engine.diagnose(model, series, **options, kept=parts, early=told.append)
    again = []
    engine.diagnose(
        model, series, **options, kept=json.loads(json.dumps(parts)), early=again.append
    )
    assert again == told


@pytest.mark.slow
def test_what_is_known_early_is_a_report():
    model, series, options = two_effects()
    told = []
    engine.diagnose(model, series, **options, early=told.append)
    for early in told:
        page = report_html({"early": early})
        assert "so far" in page
        assert "Free-run simulation of reading and the data" in page
    assert "bias:reading" in page
