"""The table of candidates over the horizon has no columns that say nothing."""

import pytest

from engine.presentation import over_horizon as words


def table(gains):
    candidates = [
        {"effects": (), "errors": (1.0, 1.0), "gains": (0.0, 0.0)},
        {"effects": ("bias:y",), "errors": (0.5, 0.25), "gains": gains},
        {"effects": ("gain:y",), "errors": (0.75, None), "gains": (None, None)},
    ]
    return {"horizons": (1, 300), "budgets": (1.0, 0.1), "candidates": candidates}


@pytest.mark.parametrize("nothing", [None, float("nan")])
def test_likelihoods_that_could_not_be_compared_have_no_columns(nothing):
    """Of a file they are None, of a result NaN."""
    d = table((nothing, nothing))
    assert words.head(d) == ["candidate", "1", "all 300"]
    assert words.rows(d) == [
        ["as given", "100 %", "100 %"],
        ["bias:y", "50 %", "25 %"],
        ["gain:y", "75 %", "-"],
    ]
    assert "2 x log-likelihood" not in words.said(d)
    assert "could not be compared" in words.said(d)


def test_those_of_one_candidate_are_enough_for_them():
    d = table((7.0, None))
    assert words.head(d) == ["candidate", "1", "all 300", "its noise", "0.1 of it"]
    assert words.rows(d)[1][-2:] == ["7", "-"]
    assert words.rows(d)[2][-2:] == ["-", "-"]
    assert "2 x log-likelihood gained" in words.said(d)
