"""The picture of errors over time leaves out predictions from next to nothing."""

import pytest

from engine.presentation.report.comparison import errors_over_time


def curves(y, half):
    return {
        "curves": {
            "t": [0.0, 1.0, 2.0, 3.0],
            "measured": {"y": [5.0, 5.1, None, 5.3]},
            "y": {"y": y},
            "lower": {"y": [a - h for a, h in zip(y, half, strict=True)]},
            "upper": {"y": [a + h for a, h in zip(y, half, strict=True)]},
        }
    }


def test_the_first_prediction_from_a_wide_density_is_left_out_and_a_simulation_is_whole():
    symptoms = {
        "one_step": curves([0.0, 5.0, 5.2, 5.2], [20.0, 0.2, 0.2, 0.2]),
        "free_run": curves([4.0, 4.0, 4.0, 4.0], [0.1, 1.0, 5.0, 9.0]),
    }
    (chart,) = errors_over_time(symptoms, {"y": "m"})
    simulated, predicted = (trace.y for trace in chart.traces)
    nan = float("nan")
    assert predicted == pytest.approx([nan, 0.1, nan, 0.1], nan_ok=True)
    assert simulated == pytest.approx([1.0, 1.1, nan, 1.3], nan_ok=True)
