"""What a search has found: its rounds, the fits before and after, and what they gained together."""

from __future__ import annotations

from dataclasses import dataclass

from engine.data.series import Series
from engine.diagnose.search.refits import Refit, cost
from engine.diagnose.search.rounds import Round
from engine.estimation.quasi_ml import QuasiFit


@dataclass(frozen=True, eq=False)
class Search:
    """All rounds; the last one without refits has no alarm. ``base`` and ``final`` fits.

    ``of_the_steps`` is what a last round would have found, where shorter steps explain it; ``unweighed`` are
    choices that were not weighed beside the effects found after them. ``as_well`` are effects that together
    explain as much as those found in turn, and are others.
    """

    base: QuasiFit
    final: QuasiFit
    rounds: tuple[Round, ...]
    alarm_left: bool
    of_the_steps: str = ""
    unweighed: tuple[str, ...] = ()
    as_well: tuple[str, ...] = ()

    @property
    def named(self) -> tuple[Refit, ...]:
        """What leads each round that has named something."""
        return tuple(found.refits[0] for found in self.rounds if found.equivalent)

    def score(self, series: Series) -> float:
        """2 x log-likelihood gained by all effects together, less what their parameters cost."""
        costs = sum(cost(one.effect, series) for one in self.named)
        return 2.0 * (self.final.log_likelihood - self.base.log_likelihood) - costs
