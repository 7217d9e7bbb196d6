"""The blind benchmark's own parts: cells that exist, sizes that were made, rows that say what happened."""

import numpy as np
import pytest

from engine.diagnose.catalogue import make_effect
from engine.studies.blind import figures
from engine.studies.blind.bases import BASES, typical
from engine.studies.blind.cells import BOOTSTRAP, CLEAN, HARD, HIDDEN, OTHER, UNLISTED, USUAL, Cell
from engine.studies.blind.hidden import draw
from engine.studies.blind.outside import play
from engine.studies.blind.report import BLIND
from engine.studies.blind.runs import work
from engine.studies.blind.sizes import size

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


def test_a_row_tells_what_was_hidden_and_what_was_said():
    cell = Cell("linear-2", "step:y", rows=200)
    row = work([cell], 99, 5, 0)
    assert row == work([cell], 99, 5, 0) | {"seconds": row["seconds"]}
    assert row["hidden"] == "step:y"
    assert row["size_true"] == size(cell)
    assert row["verdict"] in ("nothing", "named", "set", "unknown")
    assert figures.exact(row) is (row["verdict"] == "named" and row["causes"] == "step:y")
    assert np.isfinite([row["score_truth"], row["gain_truth"], row["ratio_truth"]]).all()
