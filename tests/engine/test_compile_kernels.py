"""What ``python -m engine.compile_kernels`` compiles is all that estimations on any model use."""

from __future__ import annotations

import numpy as np
import pytest

import engine
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


def column_by_column(x):
    return np.asfortranarray(np.array(x, dtype=float))


def read_only(x):
    out = np.array(x, dtype=float)
    out.setflags(write=False)
    return out


def every_second(x):
    out = np.array(x, dtype=float)
    return np.repeat(out, 2, axis=-1)[..., ::2]


@pytest.mark.long
@pytest.mark.parametrize("laid_out", [column_by_column, read_only, every_second])
@pytest.mark.parametrize("nz", [0, 1])
def test_arrays_of_users_need_no_kernel_in_another_form(laid_out, nz):
    """Whatever layout a model's functions, its first state and the points it is asked at have."""

    def drift(a, u, t, theta):
        rates = np.stack([-theta.k * a[:, 0] ** 3 + u[0], a[:, 0] - a[:, -1]], axis=1)
        return laid_out(rates), laid_out(np.full((2, nz), -0.3))

    def jacobian(a, u, t, theta):
        J = np.zeros((len(a), 2, 2 - nz))
        J[:, 0, 0], J[:, 1, 0] = -3.0 * theta.k * a[:, 0] ** 2, float(nz == 0)
        J[:, 1, -1] -= float(nz == 0)
        return laid_out(J)

    class Normal:
        """A density of the user's own."""

        mean, cov = laid_out(np.zeros(2 - nz)), laid_out(np.eye(2 - nz))

        def sample(self, rng, n):
            return laid_out(rng.standard_normal((n, 2 - nz)))

        def log_density(self, a):
            return laid_out(-0.5 * (a**2).sum(axis=1))

    states = {"a": "1"} if nz else {"a": "1", "b": "1"}
    models = [
        engine.continuous(
            name="laid out",
            drift=drift,
            jacobian=own_slopes,
            diffusion=lambda a, u, t, theta: laid_out([[0.1, 0.02], [0.02, 0.1]]),
            measurement=lambda a, u, t, theta: (
                laid_out(a[:, :1]),
                laid_out(np.full((1, nz), 0.5)),
                laid_out([[0.2]]),
            ),
            initial=lambda theta, first=first: (
                first,
                laid_out(np.zeros(nz)),
                laid_out(np.eye(nz)),
            ),
            nonlinear=states,
            linear={"z": "1"} if nz else {},
            inputs={"u": "1"},
            outputs={"y": "1"},
            parameters=[engine.Parameter("k", 0.9, bounds=(0.0, 2.0))],
        )
        for own_slopes, first in (
            (None, Normal()),
            (jacobian, engine.Gaussian(laid_out(np.zeros(2 - nz)), laid_out(np.eye(2 - nz)))),
        )
    ]
    warm()
    before = compiled_kernels()
    rng = np.random.default_rng(0)
    series = Series(rng.standard_normal((LONG, 1)), rng.standard_normal((LONG, 1)), dt=0.5)
    for model in models:
        own = model.record(model.theta())
        model.dynamics(column_by_column(np.ones((3, 2 - nz))), np.ones(1), 0.0, 0.5, own)
        rbps_em(model, series, n_particles=6, n_iterations=1)
        engine.fit_simulation(model, series, n_starts=1)
    after = compiled_kernels()
    assert {name: after[name] - before[name] for name in after if after[name] != before[name]} == {}


def test_a_density_keeps_its_numbers_when_the_arrays_it_was_made_of_are_written_into():
    mean, cov = np.zeros(2), np.eye(2)
    first = engine.Gaussian(mean, cov)
    mean[0] = cov[0, 0] = 7.0
    assert first.mean[0] == 0.0
    assert first.cov[0, 0] == 1.0
