"""Points that are guessed where there is no record may be where a model's law has no number."""

import numpy as np

import engine
from engine.diagnose.effects.clock import reads_no_clock
from engine.diagnose.effects.setting import Setting


def rectifier():
    """A capacitor behind a diode, whose current overflows 20 V beyond what it ever carries."""

    def drift(a, u, t, theta):
        return [-theta.i * (np.exp(a[:, 0] / 0.026) - 1.0) + u[0]], np.zeros((1, 0))

    return engine.continuous(
        name="rectifier", drift=drift, diffusion=lambda a, u, t, theta: [[1e-4]],
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[1e-4]]),
        initial=lambda theta: (engine.Gaussian([0.5], [[25.0]]), [], np.zeros((0, 0))),
        nonlinear={"voltage": "V"}, linear={}, inputs={"current": "A"}, outputs={"reading": "V"},
        parameters=[engine.Parameter("i", 1e-9, "A", (0.0, 1.0))],
    )  # fmt: skip


def test_of_a_law_that_overflows_there_zeros_and_clocks_are_looked_up_without_a_warning():
    model = rectifier()
    assert Setting(model).zero("voltage") == 0.0
    records = [engine.Series(np.zeros((9, 1)), np.ones(9), dt=1.0) for _ in range(2)]
    assert reads_no_clock(model, records, records)
