"""What a search has found: its rounds, the fits before and after, and what they gained together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from engine.data.series import Series
from engine.diagnose.refits.refitted import Refit, cost
from engine.diagnose.refits.rounds import MARGIN, Round
from engine.estimation.quasi_ml import QuasiFit


@dataclass(frozen=True, eq=False)
class Search:
    """All rounds; the last one without refits has no alarm. ``base`` and ``final`` fits.

    ``of_the_steps`` is what a last round would have found, where shorter steps explain it; ``unweighed`` are
    choices that were not weighed beside the effects found after them. ``as_well`` are effects that together
    explain as much as those found in turn, and are others. ``by_the_steps`` decide the first round, so that
    it ended there, to be begun with shorter ones. ``begun`` is the first round as it was found, with nothing
    beside it; ``small_rest`` where what was seen after it is left without a name;
    ``at_once`` are steps that came at one time, and pulses that are a part of them, one event.
    """

    base: QuasiFit
    final: QuasiFit
    rounds: tuple[Round, ...]
    alarm_left: bool
    of_the_steps: str = ""
    unweighed: tuple[str, ...] = ()
    as_well: tuple[str, ...] = ()
    by_the_steps: bool = False
    begun: Round | None = None
    small_rest: bool = False
    at_once: tuple[str, ...] = ()

    @property
    def named(self) -> tuple[Refit, ...]:
        """What leads each round that has named something."""
        return tuple(found.refits[0] for found in self.rounds if found.equivalent)

    @property
    def has_noise_apart(self) -> bool:
        """Whether noise and a cause were found, and each gains more beside the other than by itself.

        Two that explain one thing gain less beside each other: what one has explained is no longer there for
        the other. Two that are both there hide each other, so that each is seen better once the other is known.
        With G the gain of both, and g_1 and g_2 what each adds to the other, alone they gain G - g_2 and
        G - g_1. Outliers are left out of what is searched after them, and their gain is another one.
        """
        named = self.named
        sizes = {one.effect.size.name for one in named}
        noises = sum(one.effect.family == "noise" for one in named)
        if len(named) != 2 or noises != 1 or any(one.effect.traits.outliers for one in named):
            return False
        # a gain tells what an effect adds to the other only where it was refitted beside it
        if not all(sizes <= {*one.fit.model.parameter_names} for one in named):
            return False
        together = 2.0 * (self.final.log_likelihood - self.base.log_likelihood)
        return sum(one.gain for one in named) > together + MARGIN

    def score(self, series: Series) -> float:
        """2 x log-likelihood gained by all effects together, less what all their parameters cost.

        Sizes as well: of two searches one may have found more effects, the last of them for what is wrong with
        its first.
        """
        costs = sum(cost(one.effect, series) + size_cost(series) for one in self.named)
        return 2.0 * (self.final.log_likelihood - self.base.log_likelihood) - costs


def without_names(search: Search) -> Search:
    """A search that saw what the first round of this one did, and found nothing in it."""
    first = replace(search.rounds[0], equivalent=())
    return Search(search.base, search.base, (first,), alarm_left=False)


def size_cost(series: Series) -> float:
    """What an effect's size must gain where another search does without the effect (Schwarz 1978)."""
    return float(np.log(series.n_measured))
