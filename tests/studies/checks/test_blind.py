"""The blind benchmark's own parts: cells that exist, sizes that were made, rows that say what happened."""

import csv
from pathlib import Path

import numpy as np
import pytest

from engine.diagnose.effects.catalogue import make_effect
from tests.studies.blind import figures
from tests.studies.blind.bases import BASES, typical
from tests.studies.blind.cells import BOOTSTRAP, CLEAN, HARD, HIDDEN, OTHER, UNLISTED, USUAL, Cell
from tests.studies.blind.hidden import draw
from tests.studies.blind.outside import play
from tests.studies.blind.report import BLIND
from tests.studies.blind.rules import Rule, decided
from tests.studies.blind.runs import work
from tests.studies.blind.sizes import size

EVERY = [*USUAL, *HARD, *OTHER, *UNLISTED, *BOOTSTRAP]


@pytest.mark.parametrize("cell", dict.fromkeys([*EVERY, *CLEAN]), ids=lambda cell: cell.name)
def test_each_cell_has_its_effect_and_its_size(cell):
    if cell.effect and not cell.effect.startswith("outside"):
        assert make_effect(cell.effect, typical(cell.base, cell.rows)).name == cell.effect
    hides = cell.effect not in ("", "outside:play")
    assert (size(cell) > 0.0) is hides


def test_the_benchmark_is_as_large_as_it_says():
    kinds = {effect.partition(":")[0] for effects in HIDDEN.values() for effect in effects}
    assert len(kinds) >= 16
    assert all(len(effects) >= 6 for effects in HIDDEN.values())
    runs = {arm.name: n for arm, n in BLIND.arms.items()}
    assert runs["blind.usual"] >= 20 * len(USUAL)
    assert runs["blind.other"] >= 10 * len(OTHER)
    assert runs["blind.clean"] >= 300
    assert {cell.rows for cell in CLEAN} == {200, 1000, 4000}
    assert {cell.base for cell in CLEAN} == set(BASES)


def test_a_hidden_series_has_its_effect_and_a_clean_one_has_not():
    cell = Cell("linear-2", "step:y", rows=200)
    with_step = draw(cell, 50.0, np.random.default_rng(1))
    tau = with_step.own[1]
    before = with_step.train.t < tau
    jump = np.median(with_step.train.y[~before][:3]) - np.median(with_step.train.y[before][-3:])
    assert jump == pytest.approx(50.0, abs=10.0)
    assert draw(Cell("linear-2", "", 200, 0.0), 0.0, np.random.default_rng(1)).effect is None


def test_play_follows_only_once_it_is_taken_up():
    x = np.array([0.0, 0.5, 2.0, 1.5, 0.5, -1.0])
    assert play(x, 1.0).tolist() == [0.0, 0.0, 1.0, 1.0, 1.0, 0.0]


@pytest.mark.slow
def test_a_row_tells_what_was_hidden_and_what_was_said():
    cell = Cell("linear-2", "step:y", rows=200)
    row = work([cell], 99, 5, 0)
    assert row == work([cell], 99, 5, 0) | {"seconds": row["seconds"]}
    assert row["hidden"] == "step:y"
    assert row["size_true"] == size(cell)
    assert row["verdict"] in ("nothing", "named", "set", "unknown")
    assert figures.exact(row) is (row["verdict"] == "named" and row["causes"] == "step:y")
    assert np.isfinite([row["score_truth"], row["gain_truth"], row["ratio_truth"]]).all()


def answered(verdict, causes, among, evidence, hidden="step:y"):
    return {
        "hidden": hidden,
        "verdict": verdict,
        "causes": causes,
        "set": among,
        "evidence": evidence,
        "score_truth": 1.0,
        "score_rival": 0.0,
    }


SET = {"base": "linear-2", "rows": 1000.0} | answered(
    "set", "step:y", "step:y ramp:y latent:a", "p 0.01 step:y 20 ramp:y 18.5 latent:a 15 | p 0.5"
)
SERVO = {"base": "servo", "rows": 1000.0}
NOISE = SERVO | answered(
    "named", "colored:y", "colored:y", "p 0.01 colored:y 20 latent:a 9 | p 0.04"
)
LEFT_OVER = NOISE | {"verdict": "unknown", "evidence": "p 0.01 colored:y 20 latent:a 9 | p 0.008"}


@pytest.mark.parametrize(
    ("row", "rule", "verdict", "among"),
    [
        (SET, Rule(), "set", "step:y ramp:y latent:a"),
        (SET, Rule(margin=1.0), "set", "step:y latent:a"),
        (SET, Rule(unnamed=4.0), "set", "step:y ramp:y"),
        (SET, Rule(margin=1.0, unnamed=4.0), "named", "step:y"),
        (NOISE, Rule(), "named", "colored:y"),
        (NOISE, Rule(left=0.05), "unknown", "colored:y"),
        (LEFT_OVER, Rule(), "unknown", "colored:y"),
        (LEFT_OVER, Rule(left=0.005), "named", "colored:y"),
        ({**LEFT_OVER, "evidence": "p 0.01 colored:y 20 | p 0.004"}, Rule(left=0.005), "unknown",
         "colored:y"),
        ({**LEFT_OVER, "evidence": "p 0.01 colored:y 20 latent:a 21 | p 0.008"}, Rule(left=0.005),
         "unknown", "colored:y"),
        (answered("nothing", "", "", "p 0.3"), Rule(0.0, 0.0, 0.005), "nothing", ""),
    ],
)  # fmt: skip
def test_another_rule_makes_another_answer_of_the_same_evidence(row, rule, verdict, among):
    found = decided(row, rule)
    assert (found["verdict"], found["set"]) == (verdict, among)


def test_the_rule_as_it_is_changes_no_row_of_the_benchmark():
    for name in ("usual", "other", "outside", "clean"):
        for row in rows_of(name):
            assert decided(row, Rule()) == row


def rows_of(name):
    path = Path("tests/benchmarks/results") / f"blind.{name}.csv"
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_share_has_an_interval_over_its_series():
    rows = [{**SET, "verdict": "named", "causes": "step:y"}] * 30 + [SET] * 10
    share = figures.share_of(rows, figures.oracle_right)
    assert share.value == pytest.approx(0.75)
    low, high = share.interval
    assert low < 0.66 < 0.84 < high  # a binomial share of 40: 0.75 +- 0.13
    assert high - low == pytest.approx(4.0 * np.sqrt(0.75 * 0.25 / 40), rel=0.15)
    assert str(figures.share_of([], figures.oracle_right)) == "-"


@pytest.mark.parametrize(
    ("row", "text"),
    [
        (answered("nothing", "", "", "p 0.3"), "nothing"),
        (SET, "set with ramp:y, latent:a"),
        ({**SET, "hidden": "bias:y"}, "set: step:y"),
        (answered("named", "ramp:y", "ramp:y", ""), "named: ramp:y"),
        (answered("named", "step:y ramp:a", "step:y", ""), "named: right, then ramp:a"),
        ({**LEFT_OVER, "hidden": "colored:y"}, "unknown: right with something left"),
    ],
)
def test_a_miss_is_told(row, text):
    assert figures.miss(row) == text


def test_the_likelihood_alone_takes_no_account_of_further_parameters():
    row = {
        "base": "structure",
        "rows": 1000.0,
        "hidden": "coulomb:v1",
        "ratio_truth": 40.0,
        "evidence": "p 0.01 coulomb:v1 40 deadzone:v1 34 latent:v1 90 | p 0.5",
    }
    assert not figures.likeliest(row)  # the dead zone's width costs log 1000 = 6.9
    assert figures.likeliest({**row, "evidence": "p 0.01 coulomb:v1 40 deadzone:v1 33 | p 0.5"})
    assert figures.likeliest({**row, "evidence": "p 0.3"})
