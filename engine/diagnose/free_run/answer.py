"""The second criterion from its start to its answer: fits, rounds, verdict, causes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.data.joined import starts_of
from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.missing_function import MissingFunction, missing_function
from engine.diagnose.free_run.oversampled import thinned_by
from engine.diagnose.free_run.search import STAGE, Candidate, FreeRound, one_round
from engine.diagnose.free_run.windows import LONG, STRETCH
from engine.diagnose.free_run_fits.columns import CANNOT
from engine.diagnose.free_run_fits.fitted import Fitted, Rival, fit_runs
from engine.diagnose.free_run_fits.folds import p_better
from engine.diagnose.judging.findings import AS_GOOD, AS_LIKELY, SAME, Cause, LookAlike, Verdict
from engine.diagnose.judging.verdict import counted
from engine.diagnose.refits.amplitude import amplitude_of
from engine.diagnose.refits.likeness import as_foreseen
from engine.diagnose.screening.screening import Progress
from engine.diagnose.search.search import part_of
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.estimation.vanished import revived
from engine.simulation.fit import fit_simulation
from engine.simulation.free_run import first_state
from engine.statespace.model import Array, MixedModel, Theta
from engine.ties import TIED

STARTS = 4  # random ones beside each that is known
STARTED, SEARCHED = 0.25, 0.9  # of the search: its starts, and with them all rounds
ROUNDS = 3
SHOWN = 5  # look-alikes listed at most
LEFT = 0.05  # of the free run's error before: so little is not worth another round
LITTLE = 4.0  # 2 x log-likelihood, as one parameter gains by chance
TRUSTED = 3  # effects at most, a pair and what only shows beside it; more stand for something else
UNEXPLAINED = 0.5  # of the same: with so much left beyond noise, no name settles it
CALLED_FOR = 0.25  # of the squared error of the others: what is found takes as much, or one record calls for it


@dataclass(frozen=True, eq=False)
class FreeRunSearch:
    """All rounds of the second criterion.

    ``fits`` are those of the free run without what was found and with what each round found more, as maxima of
    the likelihood over the noise alone: parameters that a noise-free run shows are those of the free run.
    ``heights`` are their log-likelihoods on what was searched, be it a part of the ``whole`` records.
    ``missing`` is a force without a name, where the last round has an alarm that no name explains and some
    function of a signal would. ``coarse`` where the steps are too long for what was found last: what would be
    found beside it may be their error. ``alone`` is the only one of several records that calls for what was
    found, see :func:`only_one`.
    """

    rounds: tuple[FreeRound, ...]
    fits: tuple[QuasiFit, ...]
    heights: tuple[float, ...]
    missing: MissingFunction | None = None
    coarse: bool = False
    alone: Series | None = None
    whole: tuple[Series, ...] = ()

    @property
    def gains(self) -> tuple[float, ...]:
        """2 x the log-likelihood that each round gained, over the noise alone."""
        return tuple(2.0 * np.diff(self.heights))

    @property
    def before(self) -> QuasiFit:
        """The fit without what was found."""
        return self.fits[0]

    @property
    def after(self) -> QuasiFit:
        """The fit with all of it."""
        return self.fits[-1]

    def without_last(self) -> FreeRunSearch:
        """The search as if its last round that found something had found nothing."""
        k = len(self.found) - 1
        rounds = (*self.rounds[:k], replace(self.rounds[k], survivors=()))
        fits, heights = self.fits[: k + 1], self.heights[: k + 1]
        return replace(self, rounds=rounds, fits=fits, heights=heights, missing=None)

    def left_with(self, groups: Sequence[tuple[Candidate, ...]]) -> FreeRunSearch:
        """The search as if its last round that found something had these survivors, the first one chosen."""
        less, k = self.without_last(), len(self.found) - 1
        fit = groups[0][0].fit
        noise = noise_fit(fit)
        after = on_whole(fit, noise, self.whole) if self.whole else noise
        return replace(
            less,
            rounds=(*less.rounds[:k], replace(self.rounds[k], survivors=tuple(groups))),
            fits=(*less.fits, after),
            heights=(*less.heights, noise.log_likelihood),
        )

    @property
    def found(self) -> tuple[Candidate, ...]:
        """What was chosen, round by round."""
        return tuple(r.chosen for r in self.rounds if r.chosen is not None)

    @property
    def final(self) -> Fitted:
        """The last fit."""
        return self.found[-1].fit if self.found else self.rounds[0].fit

    @property
    def alarm_left(self) -> bool:
        """Whether the last round has an alarm that nothing explains."""
        return not self.rounds[-1].survivors and self.rounds[-1].alarmed

    @property
    def is_patchwork(self) -> bool:
        """Whether it takes more effects than are trusted."""
        added = (effect for chosen in self.found for effect in chosen.added)
        return len(counted(e for e in added if not as_foreseen(e, self.after))) > TRUSTED

    @property
    def verdict(self) -> Verdict:
        """As this criterion alone sees it."""
        if not self.found:
            return Verdict.UNKNOWN if self.alarm_left else Verdict.NOTHING
        left = self.final.rms / self.rounds[0].fit.rms
        if self.alone is not None or self.is_patchwork or (self.alarm_left and left > UNEXPLAINED):
            return Verdict.UNKNOWN
        if self.missing is not None and self.missing.left < UNEXPLAINED:
            return Verdict.UNKNOWN  # a function does far better than all names
        several = any(len(r.survivors) > 1 for r in self.rounds)
        return Verdict.SET if several else Verdict.NAMED


def search_free_runs(
    base: QuasiFit,
    records: Sequence[Series],
    theta: Theta,
    *,
    levels: tuple[float, float],
    kinds: Sequence[str] | None,
    seed: int,
    progress: Progress,
    rivals: Sequence[Rival] = (),
    whole: Sequence[Series] = (),
    enough: Callable[[Fitted], bool] = lambda fit: True,
) -> FreeRunSearch:
    """Search for what the free run of ``base`` gets wrong; ``theta`` is another start of its fit.

    ``rivals`` are answers of others, which are judged beside its own in the first round. ``records`` may be
    windows of the ``whole`` ones; to these both models are fitted in the end. ``levels`` are those of the alarm
    of the first round, and of the others: small patches go on being significant. ``enough`` tells whether the
    steps of the records are short enough for a fit with effects; where not, the search ends there.
    """
    held = tuple(name for name in base.model.parameter_names if name not in base.free)
    coarse = False
    starting = part_of(progress, 0.0, STARTED)
    fit = best_runs(base.model, records, [base.theta, theta], base.free, seed, starting)
    noise = [noise_fit(fit)]
    done: list[FreeRound] = []
    for k in range(ROUNDS + 1):  # the last one only asks whether noise explains the rest
        setting = setting_of(fit, held, whole or records)
        others, level = (rivals, levels[0]) if k == 0 else ((), levels[1])
        theta = noise[-1].theta
        noisy, more = np.asarray(theta), k < ROUNDS
        # nobody knows how many rounds there will be
        told = part_of(progress, *(SEARCHED - (SEARCHED - STARTED) * 0.5**i for i in (k, k + 1)))
        ahead = base.theta if k == 0 else None
        one = one_round(fit, setting, noisy, kinds, others, level, seed + k, told, more, ahead)
        done.append(one)
        if one.chosen is None:
            break
        fit = one.chosen.fit
        noise.append(noise_fit(fit))
        coarse = not enough(fit)
        if coarse or fit.rms <= LEFT * done[0].fit.rms:
            break
    progress(STAGE, SEARCHED)
    last, missing = done[-1], None
    if last.alarmed and last.chosen is None:
        missing = missing_function(fit, last.losses, setting_of(fit, held, whole or records))
    progress(STAGE, 0.5 * (SEARCHED + 1.0))
    heights = tuple(one.log_likelihood for one in noise)
    if whole and done[0].survivors:
        fits = [done[0].fit, *(one.chosen.fit for one in done if one.chosen is not None)]
        noise = [on_whole(*both, whole) for both in zip(fits, noise, strict=True)]
    alone = None
    if done[0].survivors and len(whole or records) > 1 and max(2.0 * np.diff(heights)) <= LITTLE:
        alone = only_one(done[0].fit, fit)
    every = tuple(whole)
    return FreeRunSearch(tuple(done), tuple(noise), heights, missing, coarse, alone, every)


def only_one(before: Fitted, after: Fitted) -> Series | None:
    """The record without which the others do not call for what was found; None where they do.

    What holds throughout, as a characteristic, is in the others too; what came once is not. To be asked where
    one step ahead nothing is gained: else the others may just not excite it.
    """
    records, alike = before.records, []
    for k in range(len(records)):
        rest = [i for i in range(len(records)) if i != k]
        left = [records[i] for i in rest]
        try:
            costs = [
                fit_runs(f.model, left, f.theta, f.free, f.x1[rest]).cost for f in (before, after)
            ]
        except CANNOT:
            return None
        alike.append(costs[1] / costs[0] if costs[0] > 0.0 else 0.0)
    most = int(np.argmax(alike))
    return records[most] if alike[most] > 1.0 - CALLED_FOR else None


def setting_of(fit: Fitted, held: tuple[str, ...], whole: Sequence[Series]) -> Setting:
    """For effects beside a fit to ``whole`` records or windows of them.

    Of the parameters that were ``held`` those that nothing has released.
    """
    released = {effect.channel for effect in fit.effects if effect.family == "parameter"}
    setting = setting_for(fit.model, fit.records[0], np.asarray(fit.theta))
    left = tuple(name for name in held if name not in released)
    return replace(setting, held=left, starts=starts_of(whole))


def on_whole(fit: Fitted, noise: QuasiFit, whole: Sequence[Series]) -> QuasiFit:
    """The fit of windows, gone on with on whole records; the noise is that of the windows.

    That of every k-th sample is not that of all of them, and is fitted anew.
    """
    mean, _ = first_state(fit.model, fit.theta)
    found = fit_runs(fit.model, whole, noise.theta, fit.free, np.tile(mean, (len(whole), 1)))
    theta = np.asarray(noise.theta).copy()
    theta[found.problem.active] = np.asarray(found.theta)[found.problem.active]
    if thinned_by(fit.records[0], whole[0]):
        return noise_fit(replace(found, theta=fit.model.theta(theta)))
    here = replace(noise, theta=fit.model.theta(theta))
    return replace(here, information=information(found, here))


def best_runs(
    model: MixedModel,
    records: Sequence[Series],
    starts: Sequence[Theta],
    free: Sequence[str],
    seed: int,
    progress: Progress = lambda stage, share: None,
) -> Fitted:
    """The best fit of the free run from several starts."""
    tried = []
    for i, start in enumerate(starts):

        def tell(done: int, steps: int, i: int = i) -> None:
            progress(STAGE, (i + done / steps) / len(starts))

        tried.append(
            fit_simulation(model, records, start, free, n_starts=STARTS, seed=seed, callback=tell)
        )
    best = min(tried, key=lambda found: found.nrmse)
    x1 = np.concatenate((best.a1, best.z1), axis=1)
    return fit_runs(model, records, best.theta, free, x1)


def noise_fit(fit: Fitted) -> QuasiFit:
    """The noise that the data call for beside the parameters of the free run; that of a long record's begin."""
    records = [
        one if len(one) <= LONG else one.part(0, _whole(STRETCH, one)) for one in fit.records
    ]
    if fit.noise:
        found = revived(quasi_ml(fit.model, records, fit.theta, fit.noise), records)
        return replace(found, free=fit.free, information=information(fit, found))
    whole = quasi_ml(fit.model, records, fit.theta, fit.free, max_iterations=0)
    return replace(whole, information=information(fit, whole))


def _whole(rows: int, series: Series) -> int:
    """About so many rows, of whole samples."""
    return rows // series.substeps * series.substeps


def information(fit: Fitted, found: QuasiFit) -> Array:
    """Of all free parameters (n, n): of the shown ones from the free run, of the others from the likelihood.

    Errors of a free run are hardly ever white, so the inverse is that of a sandwich. There is none along what
    parameters are tied in, be it with first states, which a sandwich has no part in: it would know of each what
    is known of them together.
    """
    n, k = len(fit.free), fit.n_parameters
    out = np.zeros((n, n))
    known = fit.problem.uncertainty(fit.e, fit.J)
    covariance = known.covariance[:k, :k]
    shown = [fit.free.index(fit.model.parameter_names[i]) for i in fit.problem.active]
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    good = scale > 0.0
    at = np.array(shown, dtype=int)[good]
    correlations = covariance[np.ix_(good, good)] / np.outer(scale[good], scale[good])
    apart = _apart(known.directions[:k], np.linalg.norm(fit.J[:, :k], axis=0) * scale)[good]
    within = np.linalg.pinv(apart.T @ correlations @ apart, rcond=1e-10, hermitian=True)
    inverse = apart @ within @ apart.T
    out[np.ix_(at, at)] = inverse / np.outer(scale[good], scale[good])
    for i, name in enumerate(found.free):
        if name in fit.free and fit.free.index(name) not in shown:
            j = fit.free.index(name)
            out[j, j] = found.information[i, i]
    return out


def _apart(directions: Array, scale: Array) -> Array:
    """Combinations (k, j) of parameters that do not change along ``directions`` (k, m), orthonormal.

    The directions are of parameters in units of their own, the combinations of these divided by ``scale`` (k,).
    A direction among first states alone has next to no part in any.
    """
    moved, share, _ = np.linalg.svd(directions, full_matrices=False)
    tied = moved[:, share > TIED] / np.where(scale > 0.0, scale, 1.0)[:, None]
    span, size, _ = np.linalg.svd(tied / np.linalg.norm(tied, axis=0), full_matrices=True)
    return np.asarray(span[:, len(size) :])


def causes_of(found: FreeRunSearch) -> tuple[Cause, ...]:
    """What was chosen, effect by effect, with what cannot be told from it."""
    rounds = zip((r for r in found.rounds if r.chosen is not None), found.gains, strict=True)
    return tuple(
        _cause(found, one, effect, gain)
        for one, gain in rounds
        if one.chosen is not None
        for effect in one.chosen.added
    )


def _cause(found: FreeRunSearch, one: FreeRound, effect: Effect, gain: float) -> Cause:
    theta, free = found.after.theta, found.after.free
    error, (amplitude, amplitude_error) = float("nan"), amplitude_of(effect, found.after)
    instead = _in_its_place(one, effect)
    if effect.size.name in free:
        error = float(found.after.standard_errors[free.index(effect.size.name)])
    return Cause(
        effect.name,
        effect.title,
        effect.family,
        effect.equation,
        float(theta[effect.size.name]),
        effect.size.unit,
        error,
        {p.name: float(theta[p.name]) for p in effect.parameters},
        one.alarm.p_value,
        gain,
        (effect.name, *instead),
        tuple(_look_alikes(one, effect, instead)),
        tuple(name for name in one.chosen.names if name != effect.name) if one.chosen else (),
        units={p.name: p.unit for p in effect.parameters},
        at_floor=one.alarm.at_floor,
        amplitude=amplitude,
        amplitude_error=amplitude_error,
    )


def _in_its_place(one: FreeRound, effect: Effect) -> list[str]:
    """Names of other sets that survive: what they have in place of this effect, or of all of the chosen."""
    chosen = set(one.chosen.names) if one.chosen is not None else set()
    out: list[str] = []
    for group in one.survivors[1:]:
        names = set(group[0].names)
        if effect.name not in names:
            out += [name for name in group[0].names if name not in chosen and name not in out]
    return out


def _look_alikes(one: FreeRound, effect: Effect, instead: Sequence[str]) -> list[LookAlike]:
    """Effects that say the same in other words, and those that were refitted in its place and lost.

    What may stand in its place beside others than it was chosen with, ``instead``, is not ruled out.
    """
    chosen = one.chosen
    if chosen is None:
        return []
    rest, out = set(chosen.names) - {effect.name}, []
    groups = [[c.names for c in group] for group in one.survivors]
    for other in one.candidates:
        apart = set(other.names) - rest
        if rest - set(other.names) or len(apart) != 1 or effect.name in apart:
            continue
        name = apart.pop()
        same = other.names in groups[0]
        survives = name in instead or any(other.names in group for group in groups)
        worse = not survives and p_better(chosen.losses, other.losses) <= one.not_worse
        likeness = float(np.corrcoef(one.fit.e - other.fit.e, one.fit.e - chosen.fit.e)[0, 1])
        said = SAME if same else ""
        if not survives and not worse:  # left for its parameters, or as its own gain is not sure
            more = other.fit.n_parameters > chosen.fit.n_parameters
            said = AS_LIKELY if more else AS_GOOD
        out.append(LookAlike(name, abs(likeness), None, worse, said))
    return out[:SHOWN]
