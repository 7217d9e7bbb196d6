"""The study of PySINDy: what it keeps of planted terms, which series it sees, how answers are counted."""

import sys

import numpy as np
import pytest

from tests.studies import sindy, sparse
from tests.studies.sparse import Setting, Way
from tests.studies.study import StudyError, Table

STATES = ("x1", "x2", "v1", "v2")
WAY = Way("step", "kept", 1e-6)
NOT_PYSINDY = "PySINDy is not installed: pip install 'rbps[dev]'"


@pytest.fixture(autouse=True)
def few_thresholds(monkeypatch):
    monkeypatch.setattr(sparse, "THRESHOLDS", sparse.THRESHOLDS[::2])


def planted(effect=None, size=0.0, rows=600):
    """States of an oscillating v1 with an effect in it, and what is independent of it; inputs."""
    rng = np.random.default_rng(5)
    x, u = rng.standard_normal((rows, 4)), rng.standard_normal((rows, 1))
    for t in range(rows - 1):
        v = x[t, 2]
        x[t + 1, 2] = 0.8 * v - 0.3 * x[t, 0] + 0.5 * u[t, 0] + 0.1 * rng.standard_normal()
        if effect:
            x[t + 1, 2] -= size * sparse.KINDS[effect](v)
    return x, u


@pytest.mark.long
@pytest.mark.parametrize("linear", ["kept", "thresholded"])
def test_a_planted_term_is_kept_alone(linear):
    pytest.importorskip("pysindy", reason=NOT_PYSINDY)
    way = Way("step", linear, 1e-6)
    for effect in (None, "drag", "coulomb"):
        x, u = planted(effect, 0.2)
        found = sparse.path(sparse.equation(x, u, 0.1, STATES, "v1", "step"), way)
        assert found.answer(Setting(way, "bic", 4.0)) == ({f"{effect}:v1"} if effect else set())
        assert len(found.terms(0)) > 12
        assert not found.kept[-1].any()


def test_rules_pick_thresholds():
    pytest.importorskip("pysindy", reason=NOT_PYSINDY)
    x, u = planted("drag", 0.2)
    found = sparse.path(sparse.equation(x, u, 0.1, STATES, "v1", "step"), WAY)
    assert found.answer(Setting(WAY, "threshold", 1.0)) == set()
    assert "drag:v1" in found.answer(Setting(WAY, "held-out", 0.0))
    assert found.answer(Setting(WAY, "held-out", 100.0)) == set()
    few, many = (len(found.answer(Setting(WAY, "bic", c))) for c in (1e3, 1e-3))
    assert few == 0
    assert many > 1


def test_the_derivative_is_a_central_difference():
    t = 0.1 * np.arange(50.0)
    x = np.column_stack([t, t, t**2, t])
    found = sparse.equation(x, np.zeros((50, 1)), 0.1, STATES, "v1", "derivative")
    np.testing.assert_allclose(found.y[1:-1], 2.0 * t[1:-1])
    assert found.names[:5] == (
        "quadratic:x1->v1",
        "cubic:x1->v1",
        "drag:x1->v1",
        "coulomb:x1->v1",
        "quadratic:x2->v1",
    )


def test_without_pysindy_the_study_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pysindy", None)
    x, u = planted(rows=50)
    with pytest.raises(StudyError, match=r"pip install 'rbps\[dev\]'"):
        sparse.path(sparse.equation(x, u, 0.1, STATES, "v1", "step"), WAY)


def test_the_series_are_those_of_the_blind_benchmark():
    for arm, stream, cells in sindy.SOURCES:
        assert arm.work.args == (tuple(cells), stream)
    series = sindy.judged_series()
    assert [one.cell for one in series[: len(sindy.CELLS)]] == list(sindy.CELLS)
    assert len({(one.arm, one.run) for one in series}) == len(series)
    for one in series:
        cells = next(cells for arm, _, cells in sindy.SOURCES if arm.name == one.arm)
        assert cells[one.run % len(cells)] == one.cell


@pytest.mark.long
def test_one_series_for_development(monkeypatch):
    pytest.importorskip("pysindy", reason=NOT_PYSINDY)
    monkeypatch.setattr(sindy, "WAYS", sparse.WAYS[:1])
    monkeypatch.setattr(sindy, "SETTINGS", sparse.SETTINGS[: len(sparse.RULES)])
    row = sindy.develop(3, 3)
    assert (row["hidden"], row["ratio"]) == ("coulomb:v1", 100.0)
    flags = str(row["right"]).split()
    assert len(flags) == len(sparse.RULES)
    assert set(flags) <= {"0", "1"}


def test_answers_are_joined_and_counted(tmp_path):
    pytest.importorskip("matplotlib")
    blank = {"seconds": 2.0, "seconds_states": 1.0, "reachable": 1}
    judged, blind = [], {arm.name: [] for arm, _, _ in sindy.SOURCES}
    verdicts = (("named", None), ("nothing", ""), ("unknown", ""), ("named", "bias:y1"))
    for run, one in enumerate(sindy.judged_series()[: 4 * len(sindy.CELLS)]):
        truth = one.cell.effect
        verdict, causes = verdicts[run // len(sindy.CELLS)]
        causes = truth if causes is None else causes
        verdict = "nothing" if verdict == "named" and not causes else verdict
        judged.append(
            blank
            | {"run": run, "hidden": truth, "ratio": one.cell.ratio, "arm": one.arm, "of": one.run}
            | {"most_right": f"{truth} quadratic:v1".strip(), "careful": truth}
        )
        blind[one.arm].append(
            {"run": one.run, "hidden": truth, "verdict": verdict, "causes": causes, "seconds": 3.0}
        )
    flags = np.zeros(len(sparse.SETTINGS), dtype=int)
    flags[7] = 1
    developed = [
        {"hidden": c.effect, "ratio": c.ratio, "right": " ".join(map(str, flags))}
        for c in sindy.CELLS
    ]
    rows = {sindy.JUDGE.name: judged, sindy.DEVELOP.name: developed, **blind}
    tables = {name: Table(some, {"seed": 0}, 1.0, 1) for name, some in rows.items()}
    text = sindy.report(tables)
    assert "| coulomb:v1 | 40 | diagnosis | 25 % (1 of 4; 5-70 %) | 1 | 1 | 1 |" in text
    assert "| clean |  | diagnosis | 50 % (2 of 4; 15-85 %) | 0 | 1 | 1 |" in text
    assert "| drag:v1 | 40 | PySINDy, most right | 0 % (0 of 4; 0-49 %) | 0 | 4 | 0 |" in text
    assert "| clean |  | PySINDy, careful | 100 % (4 of 4; 51-100 %) | 0 | 0 | 0 |" in text
    assert "the diagnosis 3.0 s" in text
    assert sindy.best(sindy.development(tables[sindy.DEVELOP.name])) == (sparse.SETTINGS[7],) * 2
    sindy.plot(tables, tmp_path / "sindy.png")
    assert (tmp_path / "sindy.png").stat().st_size > 10_000
