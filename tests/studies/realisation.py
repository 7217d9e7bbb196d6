"""The data of one run: what every arm on the same model shares."""

from __future__ import annotations

import numpy as np

from engine.simulation.simulate import Simulation, simulate
from engine.statespace.model import MixedModel

T = 200  # samples per realisation, in the report and the paper alike
DATA, START, METHOD, LIKELIHOOD = range(4)  # independent streams of random numbers of a run


def stream(seed: int, run: int, purpose: int) -> np.random.SeedSequence:
    """Random numbers of a run for one purpose."""
    return np.random.SeedSequence(seed, spawn_key=(run, purpose))


def realisation(model: MixedModel, seed: int, run: int) -> Simulation:
    """T samples at the model's default parameters, which are the true ones."""
    return simulate(model, None, T, np.random.default_rng(stream(seed, run, DATA)))
