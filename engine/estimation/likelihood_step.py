"""The M step of parameters that move what has no noise; ECME, Liu, Rubin (1994).

Where a row of x has no noise (a start z_1 = theta with P_1 = 0, a row of Q that is zero) the smoothed
states obey it exactly for theta_k and for no other theta: Q(theta, theta_k) is -inf beside theta_k, so
EM stands still and Fisher's identity does not hold. The Q-function drops such rows, which says
nothing about the parameters in them. They are moved by scoring steps on the log-likelihood itself
instead, given the others, after the M step of these. A step is taken only if the likelihood rises.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.errors import ModelError
from engine.estimation.maximization import Objective
from engine.estimation.quasi_ml import derivatives, log_likelihoods, quasi_ml
from engine.statespace.model import Array, MixedModel, Theta
from engine.ties import FLAT, Ties, flat_directions

LIKELIHOOD_STEPS = 10  # at most; near the maximum it is one, or none
FAILURES = (ModelError, ArithmeticError, ValueError, np.linalg.LinAlgError)
LIKELIER = 1.0  # nats by which another point must be likelier for an estimate to move there


@dataclass(frozen=True, eq=False)
class LikelihoodStep:
    """Scoring on the moment filter's likelihood, which is exact where ``model`` is linear in all states.

    ``exact`` says so; an expected gain below ``worth`` (nats) is no reason for a step. ``jumps`` are indices
    of parameters that move a jump of the model, to which Q is no guide either.
    """

    model: MixedModel
    all_series: Sequence[Series]
    exact: bool = False
    worth: float = 1e-4
    jumps: frozenset[int] = frozenset()

    def guides(self, q: Objective, theta: Array, indices: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Which of the parameters ``indices`` (n,) it moves, as Q is no guide to them."""
        return q.moves_noise_free(theta, indices) | np.isin(indices, list(self.jumps))

    @property
    def whose(self) -> str:
        """Whose likelihood it is, in words."""
        return "the exact" if self.exact else "the moment filter's"

    @property
    def telling(self) -> float:
        """Nats from which the particle filter is asked whether a point ahead is likelier than an estimate."""
        return LIKELIER

    @property
    def trusted(self) -> bool:
        """Whether a point ahead is likelier where the particle filter does not contradict it."""
        return False

    def __call__(self, theta: Theta, indices: NDArray[np.intp]) -> tuple[Theta, NDArray[np.bool_]]:
        """Theta after steps in the parameters ``indices`` (n,), and which of them could not be moved.

        These are the ones the likelihood does not depend on, or all, where it cannot be had.
        """
        names = [self.model.parameter_names[k] for k in indices]
        try:
            found = quasi_ml(
                self.model, self.all_series, theta, names, LIKELIHOOD_STEPS, self.worth
            )
        except FAILURES:
            return theta, np.ones(len(indices), dtype=bool)
        return found.theta, ~(np.diag(found.information) > 0.0)

    def ahead(
        self, theta: Theta, free: Sequence[str], worth: float | None = None
    ) -> tuple[Theta, float]:
        """A likelier point that scoring in the ``free`` parameters reaches, and by how much (nats).

        Steps expected to gain less than ``worth`` are not made.
        """
        here, worth = self.of(theta), self.worth if worth is None else worth
        try:
            found = quasi_ml(self.model, self.all_series, theta, free, LIKELIHOOD_STEPS, worth)
        except FAILURES:
            return theta, 0.0
        gain = found.log_likelihood - here
        return found.theta, gain if np.isfinite(gain) else 0.0

    @property
    def rows(self) -> int:
        """Of all series."""
        return sum(map(len, self.all_series))

    def of(self, theta: Theta, series: Series | None = None) -> float:
        """Log-likelihood of one series, or of all; NaN where it cannot be had."""
        which = self.all_series if series is None else [series]
        return float(_each_or_none(self.model, which, np.asarray(theta)[None])[0])

    def of_each(self, thetas: Array) -> Array:
        """The moment filter's log-likelihoods (K,) of all series at ``thetas`` (K, n_theta), in one pass."""
        return _each_or_none(self.model, self.all_series, thetas)

    def information(self, theta: Array, indices: NDArray[np.intp]) -> Array | None:
        """Of the parameters ``indices`` (n, n), or None where it cannot be had."""
        try:
            value, _, found = derivatives(self.model, self.all_series, theta, indices)
        except FAILURES:
            return None
        return found if np.isfinite(value) else None

    def ties(self, theta: Theta, indices: NDArray[np.intp], complete: Array) -> Ties:
        """Which parameters are surely only determined together.

        ``complete`` (n, n) is the complete-data information in the parameters ``indices`` (n,).
        """
        found = self.information(np.asarray(theta), indices)
        if found is None:
            return Ties()
        flat = flat_directions(found)
        surely = surely_flat(flat, found, complete)[2]
        return Ties([theta.names[i] for i in indices], flat[:, surely])

    def score(self, theta: Theta, indices: NDArray[np.intp]) -> tuple[Array, Array]:
        """Gradient (n,) and information (n, n) in the parameters ``indices``. Raises ModelError."""
        value, gradient, information = derivatives(
            self.model, self.all_series, np.asarray(theta), indices
        )
        if not np.isfinite(value):
            names = ", ".join(self.model.parameter_names[k] for k in indices)
            raise ModelError(
                f"model '{self.model.name}': {names} moves what has no noise, and {self.whose} "
                "likelihood, which alone could tell how well it is known, is not finite here"
            )
        return gradient, information


def _each_or_none(model: MixedModel, all_series: Sequence[Series], thetas: Array) -> Array:
    """Log-likelihoods (K,); NaN where one cannot be had."""
    try:
        return log_likelihoods(model, all_series, thetas)
    except FAILURES:
        if len(thetas) == 1:
            return np.array([np.nan])
        return np.concatenate([_each_or_none(model, all_series, one[None]) for one in thetas])


def surely_flat(
    flat: Array, information: Array, complete: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Of directions ``flat`` that the likelihood's information (n, n) does not hold, in its units.

    First the same in the parameters' units (n, m), then the complete-data information (m,) along each if its
    parameters were independent, then in which (m,) even complete data hold next to nothing. An approximate
    likelihood may be blind to the others.
    """
    held = np.diag(information)
    most = np.where(held > 0.0, held, np.maximum(np.diag(complete), np.finfo(float).tiny))
    along = flat / np.sqrt(most)[:, None]
    scale = (along**2 * np.diag(complete)[:, None]).sum(axis=0)
    there = np.einsum("ik,ij,jk->k", along, complete, along)
    return along, scale, np.asarray(there <= FLAT * scale)


def score_of(
    q: Objective, theta: Theta, indices: NDArray[np.intp], likelihood: LikelihoodStep | None
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Score (n,) and complete-data information (n, n) in the parameters ``indices`` by Fisher's identity.

    That does not hold for parameters that move what has no noise, or a jump, the third (n,): theirs is that of
    ``likelihood``. Raises ModelError where it cannot be had.
    """
    _, gradient, information = q.derivatives(theta, indices)
    if likelihood is None:
        return gradient, information, q.moves_noise_free(theta, indices)
    exact = likelihood.guides(q, theta, indices)
    if exact.any():
        gradient[exact], own = likelihood.score(theta, indices[exact])
        information[exact] = information[:, exact] = 0.0
        information[np.ix_(exact, exact)] = own
    return gradient, information, exact
