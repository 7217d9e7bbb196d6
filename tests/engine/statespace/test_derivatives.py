"""What stands linearly in a rate has its derivative as it is, so that steps are found once for all states."""

from __future__ import annotations

import numpy as np
import pytest

import engine
from engine.statespace.recorded.derivatives import linear_in
from engine.statespace.recorded.numbers import Recorder, Traced
from engine.statespace.tape import Tape, lines_of
from engine.statespace.traced_step import over_a_step
from engine.statespace.ways import record_way

X, K = 3.0, 2.0


@pytest.mark.parametrize(
    ("rate", "expected"),
    [
        (lambda x, y, k: -k * x + y, -K),
        (lambda x, y, k: (y - x) / k + 5.0, -1.0 / K),
        (lambda x, y, k: x * y, 7.0),
        (lambda x, y, k: k * y, 0.0),
        (lambda x, y, k: +x - y**2, 1.0),
        (lambda x, y, k: 4.0, 0.0),
        (lambda x, y, k: x * x, None),
        (lambda x, y, k: k / x, None),
        (lambda x, y, k: np.sin(x) + x, None),
        (lambda x, y, k: x if x > 1.0 else 2.0 * x, None),
    ],
)
def test_of_one_number(rate, expected):
    recorder = Recorder()
    x, y, k = (recorder.number(value) for value in (X, 7.0, K))
    with recorder:
        since = len(recorder.done)
        found = rate(x, y, k)
        slope = linear_in(x, recorder, since)(found)
    assert (slope.value if isinstance(slope, Traced) else slope) == expected


def compartments(bent=0.0):
    """Two that exchange, and what else bends."""
    return engine.continuous(
        name="compartments",
        drift=lambda a, u, t, th: (
            [u[0] - th.k * a[:, 0] - bent * a[:, 0] ** 2, th.k * a[:, 0] - th.d * a[:, 1]],
            np.zeros((2, 0)),
        ),
        diffusion=lambda a, u, t, th: np.diag([th.q, th.q]),
        measurement=lambda a, u, t, th: (a[:, 1:], np.zeros((1, 0)), [[0.1]]),
        initial=lambda th: (engine.Gaussian([1.0, 0.0], np.eye(2)), [], np.zeros((0, 0))),
        nonlinear={"gut": "mg", "blood": "mg"},
        inputs={"dose": "mg/h"},
        outputs={"y": "mg"},
        parameters=[
            engine.Parameter("k", 2.0),
            engine.Parameter("d", 0.3),
            engine.Parameter("q", 0.1),
        ],
    )


@pytest.mark.parametrize("bent", [0.0, 0.2])
def test_a_step_of_linear_equations_is_found_once_for_all_states(bent):
    """At steps of one length it is found before any state is; a difference would tell it for each by itself."""
    model = compartments(bent)
    theta = np.asarray(model.theta())
    row = np.array([1.3, 0.4]), np.array([0.5]), np.array([0.0, 0.25]), theta
    way = record_way(model.transitions, row, model.record(theta))
    tape = Tape((2, 1, len(theta)), way)
    record = np.full((9, 1), 0.5), 0.25 * np.arange(9), np.full(9, 0.25)
    lines = lines_of(tape, np.tile(theta, (3, 1)), 5, 0.25, record)
    assert any(getattr(step.function, "function", None) is over_a_step for step in way.steps)
    assert (len(lines.links) == 0) == (bent == 0.0)
