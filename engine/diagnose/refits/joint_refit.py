"""Every effect found, weighed against its rivals once more beside the effects found after it.

What an earlier round named was the best that could be said without the later ones: next to a drag that
is not known yet, Coulomb friction looks as if it faded with speed, as Stribeck's does. So each round's
rivals, the plainer kinds that its choice contains, and what a screen of the model with everything else shows
anew, are refitted in that model.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits.checkpoint import NOTHING, Kept
from engine.diagnose.refits.refitted import TOLERANCE, Refit, cost, free_parameters
from engine.diagnose.refits.rounds import FORESEEN, MARGIN, Round, settle
from engine.diagnose.screening.screen import Screen
from engine.diagnose.screening.screening import Progress
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, log_likelihoods, quasi_ml, share_done
from engine.statespace.model import Array, MixedModel

STAGE = "looking back"
RIVALS = 3  # of each round that are refitted again
NEWCOMERS = 2  # effects that are seen only beside the others
ITERATIONS = 25  # of each of these refits
BUDGET = 300  # iterations of all of them, three times as many as are usual for two effects

Values = Mapping[str, float]


def look_back(
    base: QuasiFit,
    rounds: Sequence[Round],
    series: Series,
    setting: Setting,
    kept: Kept = NOTHING,
    progress: Progress = lambda stage, share: None,
    screened: Callable[[QuasiFit], Screen] | None = None,
    margin: float = MARGIN,
    level: float = 1.0,
) -> tuple[QuasiFit, list[Round], tuple[str, ...]]:
    """The final fit and the rounds (all with a choice), each refitted beside the others' choices.

    ``screened`` screens all effects at a fit, for those of which a round saw too little before the later ones
    were known; the last round has seen them all. The third are choices that were not weighed so, because the
    BUDGET was spent: their rounds stay as found. Names within the ``margin`` of the best are a set. A choice
    that gains too little beside the others to be seen at the family-wise ``level`` is dropped: it stood for
    what one of them does.
    ``progress`` is told of every iteration: as many fits as there are rivals, and one without, make a round.
    """
    settled, fits = list(rounds), _Fits(base, series, BUDGET)
    final, earlier = settled[-1].refits[0].fit, base
    for i, found in enumerate(rounds):
        effects = [other.refits[0].effect for other in settled]
        before, after = effects[:i], effects[i + 1 :]
        here = kept.within(f"looking back {i + 1}")
        taken = [other.name for other in (*before, *after)]
        rivals = _rivals(found, taken)
        most = 1 + len(rivals) + (NEWCOMERS if screened and after else 0)
        told = partial(_tell, progress, i / len(settled), 1.0 / len(settled) / most)
        starts = partial(_starts, final.theta.asdict(), later=after)
        plain, earlier = starts(earlier.theta.asdict()), found.refits[0].fit
        try:
            without = fits.fit([*before, *after], plain, here, partial(told, 0))
        except (EngineError, np.linalg.LinAlgError):
            continue
        if screened and after:
            known = {effect.name for effect, _ in rivals} | {*taken}
            led = 2.0 * (final.log_likelihood - without.log_likelihood)
            # of several searches with this beginning each looks back beside what it found
            beside = here.further(without.model.name)
            there = all_effects(setting.beside(without.model))
            seen = beside.screen(there, partial(screened, without))
            rivals += _newcomers(seen, known, led, without.theta.asdict())
        again = []  # without outliers: they were no choice, and this filter does not see them
        for j, (effect, own) in enumerate(rivals, 1):
            if not fits.left:
                break
            try:
                among = [*before, effect, *after]
                fit = fits.fit(among, starts(own), here, partial(told, j))
            except (EngineError, np.linalg.LinAlgError):
                continue
            gain = 2.0 * (fit.log_likelihood - without.log_likelihood)
            again.append(Refit(effect, fit, gain, gain - cost(effect, series)))
        if not fits.left:
            return final, settled, tuple(effect.name for effect in effects[i:])
        weighed = settle(found.screen, again, series, setting, margin)
        if weighed.refits:
            settled[i], final = weighed, weighed.refits[0].fit
    gone = _superfluous(settled, level)
    if gone is None:
        return final, settled, ()
    left = [found for found in settled if found is not gone]
    kept = kept.further(f"without {gone.refits[0].effect.name}")
    return look_back(base, left, series, setting, kept, progress, screened, margin, level)


def _superfluous(settled: Sequence[Round], level: float) -> Round | None:
    """The round whose choice is least seen beside the others, if not at this level; never the only one."""
    if len(settled) == 1:
        return None
    p_values = []
    for found in settled:
        chosen = found.refits[0]
        scores = [s for s in found.screen.scores if s.effect.name == chosen.effect.name]
        p_values.append(
            max((found.screen.family_wise(s.p_of(chosen.gain)) for s in scores), default=0.0)
        )
    worst = int(np.argmax(p_values))
    return settled[worst] if p_values[worst] > level else None


def _tell(progress: Progress, begin: float, width: float, j: int, k: int) -> None:
    """That iteration k of fit j begins; each fit is a ``width`` of the whole."""
    progress(STAGE, begin + width * (j + share_done(k)))


def _rivals(found: Round, taken: Sequence[str]) -> list[tuple[Effect, Values]]:
    """Effects that may be a round's cause, with what it found beside them, but those ``taken`` by other rounds.

    The choice, the next best, the unnamed force, and plainer kinds that the choice contains.
    """
    named = [r for r in found.refits if not r.effect.traits.outliers]
    refits = [*named[: 1 + RIVALS], *([found.generic] if found.generic else [])]
    out = {r.effect.name: (r.effect, r.fit.theta.asdict()) for r in refits}
    chosen = found.refits[0]
    plainer = chosen.effect.traits.contains
    for effect in (score.effect for score in found.screen.scores):
        if effect.kind in plainer and effect.channel == chosen.effect.channel:
            like = {**chosen.fit.theta.asdict(), effect.size.name: chosen.size}
            out.setdefault(effect.name, (effect, like))
    return [rival for name, rival in out.items() if name not in taken]


def _newcomers(
    seen: Screen, known: Collection[str], led: float, without: Values
) -> list[tuple[Effect, Values]]:
    """The effects most seen that are not ``known`` and may gain, 2 x log-likelihood, as much as ``led``.

    Each with where its refit may begin, from the parameters ``without`` it.
    """
    promising = [
        score
        for score in sorted(seen.scores, key=lambda score: (-score.statistic, score.effect.name))
        if score.effect.name not in known
        and not (score.effect.traits.outliers or score.effect.traits.unnamed)
        and FORESEEN * score.statistic >= led
    ]
    return [
        (score.effect, {**without, **_values(score.effect, (score.size, *score.at))})
        for score in promising[:NEWCOMERS]
    ]


def _values(effect: Effect, own: Sequence[float]) -> Values:
    return dict(zip((p.name for p in effect.parameters), own, strict=True))


def _starts(known: Values, own: Values, later: Sequence[Effect]) -> list[Values]:
    """Where a joint refit may start: at what is ``known``, at its ``own`` round's beside that, and that alone.

    What is known has the little noise that all effects together leave. Without one of them the likelihood is
    next to nothing there, and it takes dozens of steps to climb out. A round's own refit, without what was
    found later, is as likely as it was in that round.
    """
    beside = {**known, **own}
    return [{**own, **known}, beside, {**beside, **{e.size.name: 0.0 for e in later}}]


@dataclass(eq=False)
class _Fits:
    """Fits of a base model with several effects at once, with so many iterations ``left`` for all of them."""

    base: QuasiFit
    series: Series
    left: int

    def fit(
        self,
        effects: Sequence[Effect],
        starts: Sequence[Values],
        kept: Kept,
        told: Callable[[int], object],
    ) -> QuasiFit:
        """One of them, from the likeliest of the starts; one that is cut off counts as given up."""
        model = self.base.model
        for effect in effects:
            model = effect.apply(model)
        free = [*self.base.free, *(name for effect in effects for name in free_parameters(effect))]
        rows = [[values.get(p.name, p.default) for p in model.parameters] for values in starts]
        thetas = np.clip(rows, model.lower, model.upper)
        most = min(ITERATIONS, self.left)

        def fitted() -> QuasiFit:
            start = _likeliest(model, self.series, thetas)
            found = quasi_ml(model, self.series, start, free, most, TOLERANCE, callback=told)
            return replace(found, given_up=not found.converged and found.iterations == most)

        found = kept.fit(model, fitted)
        self.left -= found.iterations
        return found


def _likeliest(model: MixedModel, series: Series, thetas: Array) -> Array:
    """Of the parameter vectors (K, n_theta); those that the filter cannot follow come last."""
    try:
        values = log_likelihoods(model, [series], thetas)
    except (
        EngineError,
        np.linalg.LinAlgError,
    ):  # at one of them, and the others are none the worse
        values = np.array([_value(model, series, theta) for theta in thetas])
    return np.asarray(thetas[int(np.argmax(np.where(np.isfinite(values), values, -np.inf)))])


def _value(model: MixedModel, series: Series, theta: Array) -> float:
    try:
        return float(log_likelihoods(model, [series], theta[None])[0])
    except (EngineError, np.linalg.LinAlgError):
        return -np.inf
