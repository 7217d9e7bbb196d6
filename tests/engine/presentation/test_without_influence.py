"""What is said of parameters that a fit of the simulation leaves where they began."""

import numpy as np

import engine
from engine.presentation.report import comparison_html
from engine.presentation.two_results import compare_results


def test_a_comparison_counts_no_errors_from_a_value_that_nothing_moved():
    one = {"value": 1.0, "standard_error": None, "unit": "m", "fixed": True, "silent": True}
    other = {"value": 1.5, "standard_error": 0.01, "unit": "m"}
    compared = compare_results({"estimate": {"q": one}}, {"estimate": {"q": other}})
    (row,) = compared["parameters"]
    assert (row["silent"], row["difference"], row["in_errors"]) == ([True, False], 0.5, None)
    text = comparison_html(compared, ["a", "b"])
    assert "1, no influence" in text
    assert "held at" not in text


def test_a_fit_that_estimated_nothing_says_so():
    y = np.sin(0.1 * np.arange(40.0))
    u = np.ones(40)
    series = engine.Series(y, u, dt=0.1)
    found = engine.fit_simulation(engine.get_model("oscillator"), series, free=["sigma_v"])
    assert found.message.startswith("Nothing was estimated")
