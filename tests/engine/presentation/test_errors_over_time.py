"""The picture of errors over time leaves out predictions from next to nothing."""

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
    drawn = []
    errors_over_time(symptoms, {"y": "m"}, lambda chart: drawn.append(chart))
    simulated, predicted = drawn[0].traces
    assert [round(e, 6) if e is not None else None for e in predicted.y] == [None, 0.1, None, 0.1]
    assert [round(e, 6) if e is not None else None for e in simulated.y] == [1.0, 1.1, None, 1.3]
