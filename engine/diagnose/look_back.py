"""Every effect found, weighed against its rivals once more beside the effects found after it.

What an earlier round named was the best that could be said without the later ones: next to a drag that
is not known yet, Coulomb friction looks as if it faded with speed, as Stribeck's does. So each round's
rivals, and the plainer kinds that its choice contains, are refitted in the model with everything else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from engine.diagnose.catalogue import make_effect
from engine.diagnose.effect import Effect
from engine.diagnose.refits import NESTS, TOLERANCE, Refit, cost, free_parameters
from engine.diagnose.rounds import Round, settle
from engine.diagnose.setting import Setting
from engine.diagnose.tails import KIND as TAILS
from engine.errors import EngineError, OptionError
from engine.quasi_ml import QuasiFit, quasi_ml
from engine.series import Series

RIVALS = 4  # of each round that are refitted again


def look_back(
    base: QuasiFit, rounds: Sequence[Round], series: Series, setting: Setting
) -> tuple[QuasiFit, list[Round]]:
    """The final fit and the rounds (all with a choice), each refitted beside the others' choices."""
    settled = list(rounds)
    final = settled[-1].refits[0].fit
    for i, found in enumerate(settled):
        effects = [other.refits[0].effect for other in settled]
        try:
            without = _together(base, final, [*effects[:i], *effects[i + 1 :]], {}, series)
        except (EngineError, np.linalg.LinAlgError):
            continue
        again = [r for r in found.refits if r.effect.kind == TAILS]  # by another filter
        for effect, own in _rivals(found, setting):
            try:
                beside = [*effects[:i], effect, *effects[i + 1 :]]
                fit = _together(base, final, beside, own, series)
            except (EngineError, np.linalg.LinAlgError):
                continue
            gain = 2.0 * (fit.log_likelihood - without.log_likelihood)
            again.append(Refit(effect, fit, gain, gain - cost(effect, series)))
        weighed = settle(found.screen, again, series)
        if weighed.refits:
            settled[i], final = weighed, weighed.refits[0].fit
    return final, settled


def _rivals(found: Round, setting: Setting) -> list[tuple[Effect, dict[str, float]]]:
    """Effects that may be a round's cause, with their own parameters.

    The choice, the next best, the unnamed force, and plainer kinds that the choice contains.
    """
    named = [r for r in found.refits if r.effect.kind != TAILS]
    refits = [*named[: 1 + RIVALS], *([found.generic] if found.generic else [])]
    out = [(r.effect, {p.name: r.fit.theta[p.name] for p in r.effect.parameters}) for r in refits]
    chosen = found.refits[0]
    for kind in NESTS.get(chosen.effect.kind, ()):
        try:
            effect = make_effect(f"{kind}:{chosen.effect.channel}", setting)
        except OptionError:
            continue
        if all(effect.name != other.name for other, _ in out):
            out.append((effect, {effect.size.name: chosen.size}))
    return out


def _together(
    base: QuasiFit,
    known: QuasiFit,
    effects: Sequence[Effect],
    own: Mapping[str, float],
    series: Series,
) -> QuasiFit:
    """The base model with all effects at once, started at what is known of their parameters."""
    model = base.model
    for effect in effects:
        model = effect.apply(model)
    values = {**known.theta.asdict(), **own}
    start = [values.get(p.name, p.default) for p in model.parameters]
    free = [*base.free, *(name for effect in effects for name in free_parameters(effect))]
    return quasi_ml(
        model, series, np.clip(start, model.lower, model.upper), free, tolerance=TOLERANCE
    )
