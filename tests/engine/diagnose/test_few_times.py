"""Scores that a few outlying times make up: a random sign leaves them as large as they are."""

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.screening import screen as scores

ROWS = 200
SETTING = Setting(engine.get_model("mixed-4"))


def a_test(name, s):
    """Of an effect with the scores ``s`` (n, ROWS), n of them at other values of its parameters."""
    s = np.atleast_2d(s)
    n = len(s)
    vectors = np.eye(ROWS)[:1]
    return scores.Test(
        make_effect(name, SETTING), s, np.full(n, float(ROWS)), np.ones(n), ((),) * n, vectors
    )


def noise(seed, n=1):
    return np.random.default_rng(seed).standard_normal((n, ROWS))


def sure(seed):
    """Scores of an effect that every reading shows a little: a statistic of about 100."""
    return noise(seed) + 10.0 / np.sqrt(ROWS)


@pytest.mark.parametrize("columns", [1, 40])
@pytest.mark.parametrize("size", [0.0, 30.0, 1e3, 1e6])
def test_they_do_not_hide_what_all_readings_show(size, columns):
    outlying = noise(1, columns)
    outlying[:, 77] += size * np.sqrt(ROWS)
    seen = scores.screen(
        [a_test("bias:y1", sure(2)), a_test("bias:y2", outlying)], np.random.default_rng(3), 0.05
    )
    assert seen.p_value <= 0.01
    assert seen.scores[0].effect.name == "bias:y1"


@pytest.mark.parametrize("size", [1e3, 1e6])
def test_they_are_no_evidence_by_themselves(size):
    outlying = noise(1)
    outlying[:, 77] += size * np.sqrt(ROWS)
    tests = [a_test("bias:y1", noise(2)), a_test("bias:y2", outlying)]
    assert scores.screen(tests, np.random.default_rng(3), 0.05).p_value > 0.02


def test_of_what_is_surely_there_the_larger_comes_first():
    """Probabilities below all numbers are alike; statistics are not."""
    tests = [a_test("bias:y1", noise(1) + 4.0), a_test("bias:y2", noise(2) + 40.0)]
    seen = scores.screen(tests, np.random.default_rng(3), 0.05)
    assert [score.effect.name for score in seen.scores] == ["bias:y2", "bias:y1"]
    assert seen.p_value < 0.01


def test_what_grows_towards_the_end_is_seen_though_the_last_readings_show_it_most():
    """As noise that grows: its draws are heavier than chi2, and all of them stay far below it."""
    last = [0.13, 0.14, 0.17, 0.19, 0.26, 0.33, 0.87, 2.0]
    s = np.sqrt(ROWS) * np.concatenate([np.full(ROWS - len(last), 1.8 / ROWS), last])
    draws = np.random.default_rng(5).choice([-1.0, 1.0], (499, ROWS)) @ s
    assert (draws**2).max() < 0.7 * s.sum() ** 2
    grows = a_test("bias:y2", s)
    seen = scores.screen([a_test("bias:y1", noise(2)), grows], np.random.default_rng(3), 0.05)
    assert seen.scores[0].effect.name == "bias:y2"
    assert seen.scores[0].p_value < 5e-4
    assert seen.p_value == pytest.approx(1.0 / 500.0)
