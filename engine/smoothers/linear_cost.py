"""Backward simulation in O(M) instead of O(M^2); the paper's own future work, end of section IV.

The trajectories are joint draws of x = (a, z), like those of ``rb_ffbsi(..., joint=True)``: whole, so
that neither Approximation 1 nor 2 is made.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.errors import OptionError, check_count
from engine.filters.rbpf import Filtered
from engine.kernels.linear_cost import backward_linear
from engine.kernels.resampling import stratified
from engine.randomness import Rng, generator
from engine.smoothers.exact_conditional import condition_on_trajectories
from engine.smoothers.rb_ffbsi import Smoothed

METHODS = ("mcmc", "rejection")


@dataclass(frozen=True)
class Cost:
    """How the candidates fared: share ``accepted``; share of steps that fell back to all weights."""

    accepted: float
    full: float


def rb_ffbsi_linear(
    filtered: Filtered,
    n_trajectories: int,
    rng: Rng,
    method: str = "mcmc",
    moves: int = 3,
    tries: int | None = None,
    condition: bool = True,
) -> Smoothed:
    """Draw joint trajectories in O(M + N) per time step.

    Parameters
    ----------
    filtered : Filtered
        A pass of :func:`rbpf`.
    n_trajectories : int
        Number of trajectories N that are drawn, each of weight 1/N.
    rng : numpy.random.Generator or int
        Source of all random numbers, or the seed of one.
    method : str
        ``mcmc``: Markov chain Monte Carlo moves at a fixed cost; a trajectory may keep to the filter's
        genealogy where hardly any candidate is accepted. ``rejection``: draws exactly as the full weights
        would, but hardly ever accepts in more than about two dimensions.
    moves : int
        Metropolis-Hastings steps from the particle's own ancestor, for ``mcmc``.
    tries : int, optional
        Candidates after which ``rejection`` computes all weights; M / 4, at least 16, by default.
    condition : bool
        True gives the exact moments of z given each trajectory of a; False the draws of z, with P = M = 0.

    Returns
    -------
    Smoothed
        Trajectories of a with moments of z, and the joint draws (T, N, nx).

    Raises
    ------
    OptionError
        An option is not known or out of its range; ``field`` names it.
    """
    rng = generator(rng)
    return backward_draws(filtered, n_trajectories, rng, method, moves, tries, condition)[0]


def backward_draws(
    filtered: Filtered,
    n_trajectories: int,
    rng: np.random.Generator,
    method: str = "mcmc",
    moves: int = 3,
    tries: int | None = None,
    condition: bool = True,
) -> tuple[Smoothed, Cost]:
    """As :func:`rb_ffbsi_linear`, with what the candidates cost."""
    T, M, _ = filtered.a.shape
    N, nz = n_trajectories, filtered.z.shape[2]
    if method not in METHODS:
        raise OptionError(f"method '{method}' is not known; use {' or '.join(METHODS)}", "method")
    tries = max(16, M // 4) if tries is None else tries
    for name, value in (("n_trajectories", N), ("moves", moves), ("tries", tries)):
        check_count(name, value)
    index, draws, accepted, full = backward_linear(
        filtered.a,
        filtered.z,
        filtered.root,
        filtered.weights,
        filtered.mu,
        filtered.L,
        filtered.V,
        filtered.root_plus,
        filtered.ancestors,
        stratified(filtered.weights[-1], rng.random(N)),
        rng.standard_normal((T, N, nz)),
        rng,
        tries,
        moves if method == "mcmc" else 0,
    )
    a = np.take_along_axis(filtered.a, index[:, :, None], axis=1)
    zero = np.zeros((T, 1, nz, nz))
    trajectories = np.concatenate([a, draws], axis=2)
    smoothed = Smoothed(filtered, a, draws, zero, zero[1:], index, trajectories)
    return (condition_on_trajectories(smoothed) if condition else smoothed), Cost(accepted, full)
