"""Every effect found, weighed against its rivals once more beside the effects found after it.

What an earlier round named was the best that could be said without the later ones: next to a drag that
is not known yet, Coulomb friction looks as if it faded with speed, as Stribeck's does. So each round's
rivals, and the plainer kinds that its choice contains, are refitted in the model with everything else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.screening.screening import Progress
from engine.diagnose.search.checkpoint import NOTHING, Kept
from engine.diagnose.search.refits import TOLERANCE, Refit, cost, free_parameters
from engine.diagnose.search.rounds import Round, settle
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml, share_done

STAGE = "looking back"
RIVALS = 3  # of each round that are refitted again
# of each of these refits: where noise is small, thousands of nats are climbed slowly
ITERATIONS = 25


def look_back(
    base: QuasiFit,
    rounds: Sequence[Round],
    series: Series,
    setting: Setting,
    kept: Kept = NOTHING,
    progress: Progress = lambda stage, share: None,
) -> tuple[QuasiFit, list[Round]]:
    """The final fit and the rounds (all with a choice), each refitted beside the others' choices.

    ``progress`` is told of every iteration: as many fits as there are rivals, and one without, make a round.
    """
    settled = list(rounds)
    final = settled[-1].refits[0].fit
    for i, found in enumerate(settled):
        effects = [other.refits[0].effect for other in settled]
        before, after = effects[:i], effects[i + 1 :]
        here = kept.within(f"looking back {i + 1}")
        rivals = _rivals(found, [other.name for other in (*before, *after)])
        told = partial(_tell, progress, i / len(settled), 1.0 / len(settled) / (1 + len(rivals)))
        try:
            without = _together(base, final, [*before, *after], {}, series, here, partial(told, 0))
        except (EngineError, np.linalg.LinAlgError):
            continue
        again = []  # without outliers: they were no choice, and this filter does not see them
        for j, (effect, own) in enumerate(rivals, 1):
            # the choice starts where it is beside the others, and so is never lost on the way there
            start = {} if effect.name == effects[i].name else own
            try:
                among = [*before, effect, *after]
                fit = _together(base, final, among, start, series, here, partial(told, j))
            except (EngineError, np.linalg.LinAlgError):
                continue
            gain = 2.0 * (fit.log_likelihood - without.log_likelihood)
            again.append(Refit(effect, fit, gain, gain - cost(effect, series)))
        weighed = settle(found.screen, again, series, setting)
        if weighed.refits:
            settled[i], final = weighed, weighed.refits[0].fit
    return final, settled


def _tell(progress: Progress, begin: float, width: float, j: int, k: int) -> None:
    """That iteration k of fit j begins; each fit is a ``width`` of the whole."""
    progress(STAGE, begin + width * (j + share_done(k)))


def _rivals(found: Round, taken: Sequence[str]) -> list[tuple[Effect, dict[str, float]]]:
    """Effects that may be a round's cause, with their own parameters, but those ``taken`` by other rounds.

    The choice, the next best, the unnamed force, and plainer kinds that the choice contains.
    """
    named = [r for r in found.refits if not r.effect.traits.outliers]
    refits = [*named[: 1 + RIVALS], *([found.generic] if found.generic else [])]
    out = {
        r.effect.name: (r.effect, {p.name: r.fit.theta[p.name] for p in r.effect.parameters})
        for r in refits
    }
    chosen = found.refits[0]
    plainer = chosen.effect.traits.contains
    for effect in (score.effect for score in found.screen.scores):
        if effect.kind in plainer and effect.channel == chosen.effect.channel:
            out.setdefault(effect.name, (effect, {effect.size.name: chosen.size}))
    return [rival for name, rival in out.items() if name not in taken]


def _together(
    base: QuasiFit,
    known: QuasiFit,
    effects: Sequence[Effect],
    own: Mapping[str, float],
    series: Series,
    kept: Kept,
    told: Callable[[int], object],
) -> QuasiFit:
    """The base model with all effects at once, started at what is known of their parameters."""
    model = base.model
    for effect in effects:
        model = effect.apply(model)
    values = {**known.theta.asdict(), **own}
    start = [values.get(p.name, p.default) for p in model.parameters]
    free = [*base.free, *(name for effect in effects for name in free_parameters(effect))]
    start_within = np.clip(start, model.lower, model.upper)
    fitted = partial(
        quasi_ml, model, series, start_within, free, ITERATIONS, TOLERANCE, callback=told
    )
    return kept.fit(model, fitted)
