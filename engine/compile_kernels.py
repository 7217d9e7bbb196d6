"""Compile all kernels ahead of time: ``python -m engine.compile_kernels``.

Numba compiles a kernel at its first call and keeps the machine code on disk; every later process
loads it, so that a fresh worker reaches its first iteration in well under two seconds instead of
half a minute. Run this once after installation, as the container image and the Makefile do.

The code is kept next to the package (``engine/kernels/__pycache__``) where that can be written, else
in the user's cache directory. Where neither can be written (a read-only image run by another user),
set ``NUMBA_CACHE_DIR`` to a folder that every process can read, when warming and when running. The
code depends on the processor: warm on the kind of machine that will run it.

Kernels are compiled for argument types, not for models, shapes or numbers of particles, and the
engine passes them one layout only. So a few runs on shipped models call every kernel in the form
in which all models call it; no signature is written down here that could fall out of step.
"""

from __future__ import annotations

import importlib
import multiprocessing
import pkgutil
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

import engine.kernels
from engine.data.series import Series
from engine.diagnose import diagnose
from engine.diagnose.screening.tails import prediction_pit
from engine.estimation.em import rbps_em, rts_em
from engine.estimation.quasi_ml import quasi_ml
from engine.filters.filter_steps import FilterSteps, Thetas
from engine.filters.heavy_tails import with_mixture
from engine.filters.neighbours import followed
from engine.filters.rbpf import RESAMPLING, rbpf
from engine.filters.sigma_point import moment_filter, moment_path
from engine.kernels.excitation import within_bounds
from engine.kernels.gaussian import impossible
from engine.kernels.pairs import best_pairs
from engine.kernels.sensitivities import footprints
from engine.kernels.whitening import spread, whitened
from engine.models.registry import get_model
from engine.simulation.fit import fit_simulation
from engine.simulation.free_run import free_run
from engine.simulation.sensitivities import Along
from engine.simulation.simulate import simulate
from engine.simulation.whole_record import SHORTEST, whole_record
from engine.smoothers.linear_cost import rb_ffbsi_linear
from engine.smoothers.special_case import gaussian_case, rb_ffbsi_special, rbpf_special
from engine.statespace.continuous import continuous
from engine.statespace.discretization import discretize
from engine.statespace.model import Gaussian, MixedModel
from engine.statespace.on_tape import SHORTEST as SHORTEST_ON_TAPE


def compiled_kernels() -> dict[str, set[Any]]:
    """{kernel: argument types it is compiled for in this process}."""
    return {name: set(kernel.signatures) for name, kernel in _kernels()}


def warm() -> dict[str, set[Any]]:
    """Call every kernel that estimations use; return :func:`compiled_kernels` afterwards."""
    of_particles()
    of_moments_and_runs()
    return compiled_kernels()


def of_particles() -> None:
    """The kernels of particle filters and smoothers, about half of the time."""
    rng = np.random.default_rng(0)
    model = get_model("mixed-4")
    series, free = simulate(model, None, 8, rng).series, model.parameter_names[0]
    for smoother in ("exact", "algorithm-3"):
        # of one parameter, for kernels are compiled for types and the search for a start is long
        rbps_em(model, series, free=[free], n_particles=4, n_iterations=1, smoother=smoother)
    for resampling in RESAMPLING:
        rbpf(model, None, series, 4, rng, "bootstrap", resampling, 1.0)
    rbpf(model, None, Series(np.zeros((SHORTEST_ON_TAPE, model.ny))), 4, rng)
    walk, short = _walk(rng)
    prediction_pit(rbpf(walk, None, short, 4, rng), rng)
    rb_ffbsi_linear(rbpf(walk, None, short, 4, rng), 4, rng)
    rbpf(with_mixture(walk), None, short, 4, rng)
    special = rbpf_special(gaussian_case(_decay()), None, Series(np.zeros(3)), 4, rng)
    rb_ffbsi_special(special, 4, rng)


def of_moments_and_runs() -> None:
    """Those of the moment filter, of free runs and of the design of experiments."""
    rng = np.random.default_rng(0)
    walk, short = _walk(rng)
    rts_em(walk, short, n_iterations=1)
    quasi_ml(walk, short)
    moment_filter(walk, np.asarray(walk.theta())[None], Series(np.zeros(SHORTEST_ON_TAPE)))
    followed(FilterSteps(walk, Thetas(walk, np.asarray(walk.theta())), short))
    level = with_mixture(get_model("local-level"))
    for rows in (len(short), SHORTEST_ON_TAPE):
        moment_filter(level, np.asarray(level.theta())[None], Series(np.zeros(rows)))
    diagnose(get_model("local-level"), Series(rng.standard_normal(40)), effects=["drag"])
    path = moment_path(walk, walk.theta(), short)
    T, nx, ny = len(short), walk.nx, walk.ny
    added = np.zeros((T - 1, nx)), np.zeros((T, ny))
    whitened = np.zeros((T, ny, ny)), np.zeros((T, ny))
    footprints(path.F, path.H, path.K, *whitened, *added, np.ones((T, 1)))
    tanks = get_model("tanks")
    measured = simulate(tanks, None, SHORTEST, rng, u=np.ones(SHORTEST), dt=4.0).series
    fit_simulation(tanks, measured, free=[tanks.parameter_names[0]], n_starts=1)
    discretize(np.eye(1), dt=1.0)
    decay, tanks = _decay(), with_mixture(tanks)
    numbers = decay.record(decay.theta())
    decay.transition(np.ones((2, 1)), np.zeros(0), 0.0, 1.0, numbers)
    whole_record(decay, numbers, Series(np.zeros(SHORTEST)), np.ones(1))
    for rows in (len(short), SHORTEST_ON_TAPE):
        moment_filter(tanks, np.asarray(tanks.theta())[None], measured.part(0, rows))
    impossible(np.ones((1, 1, 1)))
    run = free_run(walk, None, Series(np.zeros(SHORTEST)))
    first, x = np.arange(1), np.hstack((run.a, run.z))
    along = Along(walk, np.asarray(run.theta), run.series, x)
    along.by(first, first, np.full(1, 1e-5))
    one = np.arange(1)
    best_pairs(np.ones((1, 1)), np.zeros((1, 1)), one, one, np.ones(1, dtype=bool))
    design_kernels()


def _decay() -> MixedModel:
    """One nonlinear state, in continuous time."""
    return continuous(
        name="decay",
        drift=lambda a, u, t, theta: (-a, np.zeros((1, 0))),
        diffusion=lambda a, u, t, theta: np.eye(1),
        measurement=lambda a, u, t, theta: (a, np.zeros((1, 0)), np.eye(1)),
        initial=lambda theta: (Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))),
        nonlinear={"x": "1"},
        outputs={"y": "1"},
        parameters=[],
    )


def _walk(rng: np.random.Generator) -> tuple[MixedModel, Series]:
    """A linear model and a short series of it."""
    walk = get_model("linear-2")
    return walk, simulate(walk, None, 8, rng).series


def design_kernels() -> None:
    """Call those of the design of experiments."""
    one = np.ones((1, 2, 1, 1))
    seen = np.ones((2, 1), dtype=bool)
    whitened(one[:, :1].copy(), one, one[:, :1].copy(), one, np.eye(1), one, seen)
    spread(one[:, :1].copy(), one[:, :1].copy(), np.eye(1))
    within_bounds(np.ones(2), 0.0, 1.0, 1.0, np.zeros((1, 2)), 0.0)


def _kernels() -> Iterator[tuple[str, Any]]:
    for found in pkgutil.iter_modules(engine.kernels.__path__):
        module = importlib.import_module(f"engine.kernels.{found.name}")
        for name, value in vars(module).items():
            if hasattr(value, "signatures") and value.py_func.__module__ == module.__name__:
                yield f"{found.name}.{name}", value


def main() -> None:
    """Warm the cache and say how long it took."""
    started = time.perf_counter()
    other = multiprocessing.get_context("spawn").Process(target=of_moments_and_runs)
    other.start()  # on a second core, where there is one
    of_particles()
    other.join()
    warm()  # which loads them all, and compiles what the other process could not
    print(f"All kernels ready in {time.perf_counter() - started:.1f} s")


if __name__ == "__main__":
    main()
