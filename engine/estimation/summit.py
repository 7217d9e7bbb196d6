"""The maximum of a likelihood that is exact, above the point where iterates have settled.

The likelihood of a linear Gaussian model is known, and costs little. Steps by the scores of particles settle
anywhere on a flat ridge, and with next to no noise even exact ones may be too short. So such an estimation ends
at the maximum above its last iterate, or at another one that is known and higher. A variance next to 0 is told
to be asked for by the data only where none of some larger ones is likelier.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.errors import ModelError
from engine.estimation.em_result import EmResult
from engine.estimation.expectation import parameter_scale
from engine.estimation.likelihood_step import LikelihoodStep
from engine.estimation.vanished import likelier_with_more
from engine.estimation.wandering import moved
from engine.filters.kalman import kalman_smoother
from engine.filters.sigma_point import free_thetas
from engine.statespace.base import Theta

LEAST_NATS = 0.01  # nobody cares for less
CLIMBS = 5  # of a few steps each, at most, from one point
SMALL = 1e-3  # of a parameter's size: below it larger values are tried ...
SHARES = 10.0 ** -np.arange(7.0)  # ... which are these shares of it
FOUND = (
    " The model is linear Gaussian: the estimate is the maximum of its exact likelihood, {:.2g} nats above the "
    "last iterates."
)


@dataclass(frozen=True, eq=False)
class Summit:
    """Where an estimation ends whose ``likelihood`` is exact for linear Gaussian models.

    Gains below ``worth`` (nats) move nothing. ``known()`` are other maxima that were found before; ``checked``
    tells that the model is linear Gaussian for all theta.
    """

    likelihood: LikelihoodStep
    worth: float
    known: Callable[[], Sequence[Theta]] = lambda: ()
    checked: bool = False

    def serves(self, theta: Theta) -> bool:
        """Whether the model is linear Gaussian at theta."""
        model = self.likelihood.model
        if self.checked or model.random_scales:
            return self.checked
        try:
            for one in self.likelihood.all_series:
                kalman_smoother(model, theta, one)
        except (ModelError, ArithmeticError, ValueError, np.linalg.LinAlgError):
            return False
        return True

    def __call__(self, found: EmResult) -> EmResult:
        """The result, at the highest maximum that is found, where it is higher by more than is worth a word."""
        least = max(self.worth, LEAST_NATS)
        here = self.likelihood.of(found.theta)
        best, highest = found.theta, here
        elsewhere = (*self.known(), *self._larger(found), *self._with_more(found, here))
        for start in (found.theta, *elsewhere):
            theta, value = self._climbed(start, found.free, least)
            if value > highest:
                best, highest = theta, value
        if not highest - here > least or not self.serves(best):  # NaN is not
            return found
        return moved(found, best, FOUND.format(highest - here))

    def _climbed(self, theta: Theta, free: Sequence[str], least: float) -> tuple[Theta, float]:
        """The maximum above theta, and its log-likelihood."""
        for _ in range(CLIMBS):
            theta, gain = self.likelihood.ahead(theta, free, 0.1 * least)
            if not gain > 0.1 * least:
                break
        return theta, self.likelihood.of(theta)

    def unsaid(self, found: EmResult) -> EmResult:
        """The result of a run that was left, not saying that data ask for no noise where more is likelier."""
        least = self.likelihood.of(found.theta) + LEAST_NATS
        asked = {name for name, there in self._tried(found) if self.likelihood.of(there) > least}
        if not asked:
            return found
        rest = [name for name in found.free if name not in asked]
        before, now = (
            found.model.held_in_words(found.theta, free, found.ties) for free in (found.free, rest)
        )
        message = f"{found.message.removesuffix(before).rstrip()} {now}".rstrip()
        return replace(found, message=message)

    def _larger(self, found: EmResult) -> list[Theta]:
        """The likeliest of points with larger values of what is next to its bound 0, if there is any."""
        tried = [there for _, there in self._tried(found)]
        values = np.array([self.likelihood.of(one) for one in tried])
        values = np.where(np.isfinite(values), values, -np.inf)
        return [tried[int(np.argmax(values))]] if tried and values.max() > -np.inf else []

    def _with_more(self, found: EmResult, here: float) -> list[Theta]:
        """A likelier point with more of a noise that vanished to whatever side it does, if there is any."""
        model, names = self.likelihood.model, found.theta.names
        indices, theta = model.free_indices(found.free), np.asarray(found.theta)
        more = likelier_with_more(model, self.likelihood.all_series, theta, indices, here)
        return [] if more is None else [Theta(more, names)]

    def _tried(self, found: EmResult) -> list[tuple[str, Theta]]:
        """Points with a larger value of one parameter that is next to its bound 0, with its name."""
        model, theta = self.likelihood.model, np.asarray(found.theta)
        out: list[tuple[str, Theta]] = []
        for k in model.free_indices(found.free):
            size = parameter_scale(model, theta, int(k))
            if model.lower[k] == 0.0 <= theta[k] < SMALL * size:
                values = np.minimum(SHARES * size, model.upper[k])
                points = free_thetas(theta, np.array([k]), values[values > theta[k], None])
                names = found.theta.names
                out += [(names[k], Theta(one, names)) for one in points]
        return out
