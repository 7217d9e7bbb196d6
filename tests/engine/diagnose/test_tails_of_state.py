"""Outliers of a state or of its reading: each is weighed with what was found later beside it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from engine.diagnose.effects.traits import Traits
from engine.diagnose.search import search

ROWS = SimpleNamespace(n_measured=np.e**5)  # a further parameter costs 5


def one(name, score, gained, outliers=False):
    """A round led by an effect of a size alone, with the log-likelihood that its fit has."""
    effect = SimpleNamespace(
        name=name,
        parameters=("size",),
        held=(),
        traits=Traits(outliers=outliers),
    )
    fit = SimpleNamespace(log_likelihood=0.5 * gained)
    refit = SimpleNamespace(effect=effect, score=score, gain=gained, fit=fit)
    return SimpleNamespace(refits=(refit,), equivalent=(refit,), name=name)


@pytest.mark.parametrize(
    ("with_state", "with_reading", "led"),
    [
        # a cycle explains as much beside the one as beside the other, and says nothing for either
        ({"cycle": 180.0}, 140.0, ("state", "cycle")),
        # a step that the state's outliers have explained already says all for those of the reading
        ({"cycle": 132.0}, 140.0, ()),
        ({"cycle": 125.0}, 129.0, ("state",)),  # and nothing where it makes too little
    ],
)
def test_what_is_found_later_counts_for_both(with_state, with_reading, led, monkeypatch):
    """A cycle beside glitches of the sensor was likelier than jumps of the state that were left without it."""
    state, reading = one("state", 130.0, 130.0, True), one("reading", 30.0, 30.0, True)
    cycle = one("cycle", 60.0, 60.0)
    later = {id(cycle.refits[0].fit): "cycle"}

    def told_again(fit, tails, series):
        assert tails is state.refits[0]
        return SimpleNamespace(log_likelihood=0.5 * with_state[later[id(fit)]])

    monkeypatch.setattr(search, "_told_again", told_again)
    final: Any = SimpleNamespace(log_likelihood=0.5 * with_reading)
    rounds: Any = [reading, cycle]
    of_state = search._OfState(0, state, 0.0)  # type: ignore[arg-type]
    better = of_state.better(rounds, final, ROWS)  # type: ignore[arg-type]
    assert tuple(found.name for found in (better[0] if better else ())) == led
