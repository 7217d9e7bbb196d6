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

LIKELIHOOD_STEPS = 10  # at most; near the maximum it is one, or none


@dataclass(frozen=True, eq=False)
class LikelihoodStep:
    """Scoring on the moment filter's likelihood, which is exact where ``model`` is linear in all states.

    ``whose`` says whose likelihood it is, in words; an expected gain below ``worth`` (nats) is no reason for
    a step.
    """

    model: MixedModel
    all_series: Sequence[Series]
    whose: str = "the moment filter's"
    worth: float = 1e-4

    def __call__(self, theta: Theta, indices: NDArray[np.intp]) -> tuple[Theta, NDArray[np.bool_]]:
        """Theta after steps in the parameters ``indices`` (n,), and which of them could not be moved.

        These are the ones the likelihood does not depend on, or all, where it cannot be had.
        """
        names = [self.model.parameter_names[k] for k in indices]
        try:
            found = quasi_ml(
                self.model, self.all_series, theta, names, LIKELIHOOD_STEPS, self.worth
            )
        except (ModelError, ArithmeticError, ValueError, np.linalg.LinAlgError):
            return theta, np.ones(len(indices), dtype=bool)
        return found.theta, ~(np.diag(found.information) > 0.0)

    @property
    def rows(self) -> int:
        """Of all series."""
        return sum(map(len, self.all_series))

    def of(self, theta: Theta, series: Series | None = None) -> float:
        """Log-likelihood of one series, or of all; NaN where it cannot be had."""
        which = self.all_series if series is None else [series]
        try:
            return float(log_likelihoods(self.model, which, np.asarray(theta)[None])[0])
        except (ModelError, ArithmeticError, ValueError, np.linalg.LinAlgError):
            return np.nan

    def information(self, theta: Array, indices: NDArray[np.intp]) -> Array | None:
        """Of the parameters ``indices`` (n, n), or None where it cannot be had."""
        try:
            value, _, found = derivatives(self.model, self.all_series, theta, indices)
        except (ModelError, ArithmeticError, ValueError, np.linalg.LinAlgError):
            return None
        return found if np.isfinite(value) else None

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


def score_of(
    q: Objective, theta: Theta, indices: NDArray[np.intp], likelihood: LikelihoodStep | None
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Score (n,) and complete-data information (n, n) in the parameters ``indices`` by Fisher's identity.

    That does not hold for parameters that move what has no noise, the third (n,): theirs is that of
    ``likelihood``. Raises ModelError where it cannot be had.
    """
    _, gradient, information = q.derivatives(theta, indices)
    exact = q.moves_noise_free(theta, indices)
    if exact.any() and likelihood is not None:
        gradient[exact], own = likelihood.score(theta, indices[exact])
        information[exact] = information[:, exact] = 0.0
        information[np.ix_(exact, exact)] = own
    return gradient, information, exact
