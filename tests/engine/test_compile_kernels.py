"""What ``python -m engine.compile_kernels`` compiles is all that estimations on any model use."""

from __future__ import annotations

import numpy as np
import pytest

from engine import Series, get_model, rbps_em, simulate
from engine.compile_kernels import compiled_kernels, warm
from engine.simulation.free_run import free_run
from engine.simulation.whole_record import SHORTEST
from engine.statespace.on_tape import SHORTEST as SHORTEST_ON_TAPE
from tests.engine.models_for_tests import (
    awkward_series,
    draw,
    linear_mixed,
    partly_noise_free,
    random_walk,
    theta_everywhere,
)
from tests.engine.statespace.picklable_cart import cart

# called by estimations from Python; the other kernels are compiled into these, or by studies
USED = (
    "backward.",
    "conditional.",
    "filtering.",
    "gaussian.",
    "local_linearization.",
    "resampling.",
    "taped_particles.",
    "trajectory.",
)

LONG = SHORTEST_ON_TAPE + 4


def used():
    return {name: s for name, s in compiled_kernels().items() if name.startswith(USED)}


@pytest.mark.slow
def test_no_model_needs_a_kernel_in_another_form():
    warm()
    before = used()
    problems = [
        (m, awkward_series(m, LONG))
        for m in (linear_mixed(), linear_mixed(0, 2), linear_mixed(2, 0, True), linear_mixed(1))
    ]
    for m in (theta_everywhere(), theta_everywhere(False), partly_noise_free(), random_walk()):
        y = draw(m, np.zeros((LONG, 0)), np.arange(float(LONG)), np.random.default_rng(0))
        problems.append((m, Series(y)))
    problems.append(
        (cart, simulate(cart, None, LONG, np.random.default_rng(0), u=np.ones(LONG)).series)
    )
    servo = get_model("servo")
    u = np.sin(np.arange(float(LONG)))[:, None]
    problems.append((servo, simulate(servo, None, LONG, np.random.default_rng(0), u=u).series))
    for model, series in problems:
        for smoother, proposal in (("exact", "adapted"), ("algorithm-3", "bootstrap")):
            for resampling in ("systematic", "residual"):
                rbps_em(
                    model,
                    series,
                    n_particles=6,
                    n_iterations=1,
                    smoother=smoother,
                    proposal=proposal,
                    resampling=resampling,
                )
        long = Series(np.zeros((SHORTEST, model.ny)), np.ones((SHORTEST, model.nu)), dt=0.01)
        free_run(model, None, long)
    after = used()
    assert {name: after[name] - before[name] for name in after if after[name] != before[name]} == {}
