"""Random programs with conditions on tape: each row takes its own way, whatever others take."""

from __future__ import annotations

import linecache

import numpy as np
import pytest

import engine.filters.sigma_point
from engine.data.series import Series
from engine.filters.filter_steps import FilterSteps, Thetas
from engine.filters.sigma_point import moment_filter, run_on_tape
from engine.simulation.simulate import states_of
from engine.simulation.taped import run_by_tape
from engine.statespace.model import Gaussian, MixedModel, Parameter

T = 60
LEAVES = ("x", "v", "u[0]", "theta.k", "theta.c", "math.sin(0.3 * t)", "0.5", "TABLE[int(t) % 3]")
FUNCTIONS = ("math.tanh({})", "math.cos({})", "abs({})", "max({}, 0.1)", "math.sqrt(1.0 + {} ** 2)")
CONDITIONS = (
    "x > {}", "v < {}", "u[0] > {}", "t % 7.0 < 3.0", "theta.k > 0.8", "x > 0.0 and u[0] > {}",
    "not v > {} or t > 20.0", "int(t) % 4 in (1, 2)", "abs(x) < 0.2 < theta.c + {}",
)  # fmt: skip


class Program:
    """The text of a loop over particles with nested conditions."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.lines = [
            "def step(a, u, t, dt, theta):",
            "    out = np.empty_like(a)",
            "    for i, (x, v) in enumerate(a):",
        ]
        self.block(8, 3)
        self.lines += [
            "        out[i] = [0.6 * math.tanh(x), 0.8 * math.tanh(v)]",
            "    return out",
        ]

    def pick(self, among):
        return among[self.rng.integers(len(among))]

    def term(self, depth):
        if depth == 0 or self.rng.random() < 0.3:
            return self.pick(LEAVES)
        if self.rng.random() < 0.4:
            return self.pick(FUNCTIONS).format(self.term(depth - 1))
        return f"({self.term(depth - 1)} {self.pick('+-*')} {self.term(depth - 1)})"

    def block(self, indent, depth):
        for _ in range(self.rng.integers(1, 3)):
            space = " " * indent
            if depth and self.rng.random() < 0.6:
                condition = self.pick(CONDITIONS).format(round(self.rng.normal(0.0, 0.5), 2))
                self.lines.append(f"{space}if {condition}:")
                self.block(indent + 4, depth - 1)
                if self.rng.random() < 0.6:
                    self.lines.append(f"{space}else:")
                    self.block(indent + 4, depth - 1)
            else:
                name, keep = self.pick("xv"), round(self.rng.uniform(0.3, 0.9), 2)
                self.lines.append(
                    f"{space}{name} = {keep} * {name} + 0.4 * math.tanh({self.term(2)})"
                )

    def function(self):
        text = "\n".join(self.lines) + "\n"
        name = f"<program {hash(text)}>"
        linecache.cache[name] = (len(text), None, text.splitlines(True), name)
        names = {}
        exec(
            compile(
                "import math\nimport numpy as np\nTABLE = (0.1, 0.2, -0.3)\n", "<head>", "exec"
            ),
            names,
        )
        exec(compile(text, name, "exec"), names)
        return names["step"]


def model_of(step):
    return MixedModel(
        name="program",
        dynamics=lambda *given: (step(*given), np.zeros((2, 0)), theta_noise(given[-1])),
        measurement=lambda a, u, t, theta: ([a[:, 0] + a[:, 1]], np.zeros((1, 0)), [[0.1]]),
        initial=lambda theta: (Gaussian([0.3, -0.2], 0.2 * np.eye(2)), [], np.zeros((0, 0))),
        nonlinear={"x": "m", "v": "m"},
        inputs={"u": "m"},
        outputs={"y": "m"},
        parameters=[
            Parameter("k", 0.9, bounds=(0.0, 2.0)),
            Parameter("c", 0.3, bounds=(0.0, 2.0)),
        ],
    )


def theta_noise(theta):
    return np.diag([0.02, 0.01 + 0.01 * theta.c])


def compare(seed, monkeypatch):
    """Whether there is a tape of it; filters and free runs are those by calls."""
    model, rng = model_of(Program(seed).function()), np.random.default_rng(seed)
    taped = None
    for _ in range(3):
        t = np.arange(T) * 1.0 if rng.random() < 0.5 else rng.uniform(0.5, 1.5, T).cumsum()
        series = Series(rng.standard_normal((T, 1)), rng.standard_normal((T, 1)), t=t)
        thetas = np.array([0.9, 0.3]) * rng.uniform(0.7, 1.3, (3, 2))
        taped = run_on_tape(FilterSteps(model, Thetas(model, thetas), series))
        with monkeypatch.context() as patch:
            patch.setattr(engine.filters.sigma_point, "filter_by_tape", lambda *_: None)
            called = moment_filter(model, thetas, series)
        if taped is not None:
            np.testing.assert_allclose(taped.log_terms, called.log_terms, rtol=1e-7, atol=1e-7)
        x1 = np.array([0.3, -0.2])
        record = model.record(thetas[0])
        run = run_by_tape(model, record, series, x1[None], series.steps)
        if run is not None:
            expected = x1[None]
            for i in range(T - 1):
                given = series.u_step[i], float(series.t[i]), float(series.steps[i]), record
                np.testing.assert_allclose(run[i, 0], expected[0], rtol=1e-9, atol=1e-9)
                expected = model.dynamics(expected, *given)[0]
        assert states_of(model, record, series, x1).shape == (T, 2)
    return taped is not None


@pytest.mark.long
@pytest.mark.parametrize("seed", range(1, 7))
def test_random_programs_on_tape_are_what_calls_say(seed, monkeypatch):
    assert compare(seed, monkeypatch)
