"""What an extension is worth on data that neither its choice nor its estimate has seen.

Two answers: the difference of the one-step predictive log-densities, d_t = log p_ext(y_t | past) -
log p_base(y_t | past), tested one-sided by Diebold and Mariano (1995), mean(d) / sqrt(var(mean(d))) with
Newey and West's (1987) variance; and the free-run error of each output before and after, both models
started at the state that each of them estimates from the same first rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.data.joined import joined, past_of
from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.first_states import anywhere, starts_there
from engine.diagnose.gain.adoption import TEST_LEVEL, Decision, decide, runs_changed
from engine.diagnose.gain.simulation_gain import (
    DRAWN,
    OutputGain,
    drawn_from,
    free_run_from,
    noise_level,
    output_gains,
)
from engine.diagnose.gain.times import Times, times_again
from engine.diagnose.records import FEWEST_ROWS
from engine.diagnose.symptoms.error_localization import newey_west
from engine.distributions import student_sf
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.statespace.model import Array
from engine.words import enumerated

BLOCKS, EVERY = 25, 5  # of interleaved blocks
ELSEWHERE = (
    "The held-out data begin where the model's first state does not allow it: there both models begin anywhere "
    "that the record searched has been."
)
FOLDS_BELOW = 500  # rows: where fewer, each block is left out in turn


@dataclass(frozen=True, eq=False)
class Gain:
    """The gain on ``samples`` held-out rows, of which ``how`` tells the choice.

    ``log_density`` is the sum of d_t, ``per_sample`` its mean +- ``standard_error``; ``p_value`` of no gain
    (one-sided), ``p_loss`` of no loss. ``decision`` says whether they call for the extension
    (see :mod:`engine.diagnose.gain.adoption`). ``among``: the rows lie among those fitted to; ``fits`` of both
    models where their noise was fitted to them as well. For pictures: times ``t``, readings ``y``, free runs
    ``before`` and ``after`` (n, ny), differences ``d`` (n,).
    """

    how: str
    samples: int
    log_density: float
    per_sample: float
    standard_error: float
    p_value: float
    p_loss: float
    outputs: tuple[OutputGain, ...]
    decision: Decision
    notes: tuple[str, ...] = ()
    t: Array = field(default_factory=lambda: np.zeros(0), repr=False)
    y: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    before: Array | None = field(default=None, repr=False)
    after: Array | None = field(default=None, repr=False)
    d: Array = field(default_factory=lambda: np.zeros(0), repr=False)
    among: bool = False
    fits: tuple[QuasiFit, QuasiFit] | None = field(default=None, repr=False)

    @property
    def noise_of_all(self) -> bool:
        """Whether the noise of both models was fitted to these rows as well."""
        return self.fits is not None

    @property
    def adopt(self) -> bool:
        """Whether these data call for the extension; whether it is adopted tells ``Diagnosis.adopted``."""
        return self.decision is Decision.ADOPTED

    def to_dict(self) -> dict[str, Any]:
        """Numbers and notes, without the arrays over time."""
        names = ["how", "samples", "log_density", "per_sample", "standard_error"]
        names += ["p_value", "p_loss", "adopt"]
        out = {name: getattr(self, name) for name in names}
        out["outputs"] = [asdict(o) for o in self.outputs]
        out["notes"] = list(self.notes)
        return out


def measure_gain(
    base: QuasiFit,
    extended: QuasiFit,
    tests: Sequence[Series],
    history: Series | None = None,
    seed: int = 0,
    records: Sequence[Series] = (),
    anew: QuasiFit | None = None,
) -> Gain:
    """The gain of a fitted extension over the fitted base on ``tests``.

    ``history`` is the series that ends right before the only test: both filters then run through it and
    only the rows of the test are scored. So they do through that of the ``records`` which a test goes on with.
    Other tests begin anew, with ``anew`` for the extension where it is another one there, and anywhere where
    they begin as neither model says.
    """
    scored, elsewhere = [], 0
    for test in tests:
        past = history or past_of(test, records)
        whole = test if past is None else joined(past, test)
        first = len(whole) - len(test)
        rows = np.arange(len(whole)) >= first
        pair = base, extended if past is not None or anew is None else anew
        if past is None and records and not any(starts_there(fit, test) for fit in pair):
            pair = anywhere(*pair, records[0])
            elsewhere += 1
        scored.append(score([Trial(*pair, rows)], whole, first))
    how = "held-out rows" if history is None else "the last rows, held out"
    if len(tests) > 1:
        how += f" of {len(tests)} records"
    gain = gain_of(base, scored, how, seed)
    return replace(gain, notes=(*gain.notes, ELSEWHERE)) if elsewhere else gain


def measure_gain_interleaved(
    base: QuasiFit,
    extended: QuasiFit,
    records: Sequence[Series],
    times: Sequence[str] = (),
    seed: int = 0,
) -> Gain:
    """The gain on blocks of rows left out of all ``records``, for models fitted anew to the others.

    ``times`` are parameters that were sought on rows: of each fit they are sought again.

    For effects of time, which seldom happen again in the last rows of a record, nor in another one. Every
    fifth block is left out; of fewer than 500 rows, where that is too little to judge by, five times in
    turn, so that each row is left out once. A row left out of the fit is predicted knowing all
    measurements before it.
    """
    folds = range(EVERY) if sum(map(len, records)) < FOLDS_BELOW else [EVERY // 2]
    trials: list[list[Trial]] = [[] for _ in records]
    for fold in folds:
        rows = [every_fifth(len(one), fold) for one in records]
        masked = [one.masked(out) for one, out in zip(records, rows, strict=True)]
        if not any(one.observed.any() for one in masked):
            continue
        when = times_again(extended, masked, times)
        starts = (np.asarray(base.theta), when.best(np.asarray(extended.theta)))
        fits = []
        for fit, theta in zip((base, extended), starts, strict=True):
            try:
                fits.append(quasi_ml(fit.model, masked, theta, fit.free))
            except (EngineError, np.linalg.LinAlgError):
                fits.append(replace(fit, theta=fit.model.theta(theta)))
        for own, out in zip(trials, rows, strict=True):
            own.append(Trial(fits[0], fits[1], out, when))
    how = "every fifth block, left out of the fit"
    if len(trials[0]) > 1:
        how = "blocks, each left out of a fit in turn"
    if len(records) > 1:
        how += f", of {len(records)} records"
    scored = [score(own, one, 0) for own, one in zip(trials, records, strict=True)]
    return replace(gain_of(base, scored, how, seed), among=True)


def without(fit: QuasiFit, effects: Sequence[Effect]) -> QuasiFit:
    """The fit with the sizes of some of its effects at zero: where they are known not to be."""
    theta = np.asarray(fit.theta).copy()
    theta[[fit.model.index(effect.size.name) for effect in effects]] = 0.0
    return replace(fit, theta=fit.model.theta(theta))


@dataclass(frozen=True, eq=False)
class Trial:
    """Two fits and the rows (T,) that neither has seen; when effects of time of the extension may act."""

    base: QuasiFit
    extended: QuasiFit
    rows: NDArray[np.bool_]
    when: Times | None = None

    def log_terms(self, series: Series) -> tuple[Array, Array]:
        """Log-densities (T,) of a series, without and with the extension."""
        before = self.base.log_terms(series)
        if self.when is None or len(self.when.likely) == 1:
            return before, self.extended.log_terms(series)
        return before, self.when.log_terms(self.extended, series, self.rows)


@dataclass(frozen=True, eq=False)
class Scored:
    """Rows (n,) of a ``part`` that are ``kept``, with d (n,) there; free runs without and with (n, ny).

    ``floors`` (ny,) are levels of the measurement noise, one for each run of the extension; ``lost`` whether
    the filter of the base, of the extension, was; ``drawn`` makes records (N, n, ny) of the extension by
    a seed.
    """

    part: Series
    kept: NDArray[np.bool_]
    d: Array
    runs: tuple[Array, Array]
    floors: list[Array]
    lost: tuple[bool, bool]
    drawn: Callable[[int], Array]

    def by_samples(self) -> Scored:
        """The same without the rows between samples, on which nothing is measured."""
        rows = self.part.samples
        if len(rows) == len(self.part):
            return self
        return replace(
            self,
            part=self.part.held(self.part.hold),
            kept=self.kept[rows],
            d=self.d[rows],
            runs=(self.runs[0][rows], self.runs[1][rows]),
            drawn=lambda seed: self.drawn(seed)[:, rows],
        )


def score(trials: Sequence[Trial], series: Series, first: int) -> Scored:
    """Score both models of each trial on its rows; free runs start at row ``first``."""
    seen, part = series.observed.any(axis=1), series.part(first, len(series))
    d, rows = np.zeros(len(series)), np.zeros(len(series), dtype=bool)
    several = len(trials) > 1
    runs = np.full(part.y.shape, np.nan), np.full(part.y.shape, np.nan)
    floors, lost = [], [False, False]
    for trial in trials:
        marked = trial.rows & seen
        rows |= marked
        terms = trial.log_terms(series)
        d[marked] = (terms[1] - terms[0])[marked]
        lost = [one or not np.isfinite(x[marked]).all() for one, x in zip(lost, terms, strict=True)]
        shown = trial.rows[first:] if several else np.ones(len(part), dtype=bool)
        for k, fit in enumerate((trial.base, trial.extended)):
            run = free_run_from(fit, series, first)
            if run is not None:
                runs[k][shown] = run[0][shown]
                if k == 1:
                    floors.append(noise_level(fit, part, run[1]))

    def drawn(seed: int) -> Array:
        each = (drawn_from(trial.extended, series, first, seed) for trial in trials)
        if not several:
            return next(each)
        out = np.zeros((DRAWN, *part.y.shape))
        for trial, records in zip(trials, each, strict=True):
            out[:, trial.rows[first:]] = records[:, trial.rows[first:]]
        return out

    return Scored(part, rows[first:], d[first:], runs, floors, (lost[0], lost[1]), drawn)


def gain_of(base: QuasiFit, scored: Sequence[Scored], how: str, seed: int) -> Gain:
    """The gain on all samples that were scored; parts follow one another."""
    scored = [one.by_samples() for one in scored]
    part, notes = scored[0].part, list[str]()
    for one in scored[1:]:
        part = joined(part, one.part)
    kept = np.concatenate([one.kept for one in scored])
    d = np.concatenate([one.d for one in scored])
    runs = [np.concatenate([one.runs[k] for one in scored]) for k in range(2)]
    floors = [floor for one in scored for floor in one.floors]
    lost = [any(one.lost[k] for one in scored) for k in range(2)]
    n = int(kept.sum())
    if n < 2:
        notes.append("Hardly any measurement is held out: the gain cannot be measured.")
    if lost[1]:
        notes.append("The extended model's filter is lost on the held-out data.")
    if n < 2 or not np.isfinite(d).all():
        d[:] = np.nan
    mean, error, p_gain = diebold_mariano(d, kept)
    if n < FEWEST_ROWS:
        p_gain = 0.5  # of a few neighbours the scatter says nothing
    outputs: tuple[OutputGain, ...] = ()
    away = [not np.isfinite(run[kept]).all() for run in runs]
    for ran_away, name in zip(away, ("model as given", "extended model"), strict=True):
        if ran_away:
            notes.append(f"The free run of the {name} runs away on the held-out data.")
    if not any(away) and floors:
        floor = np.sqrt(np.mean(np.square(floors), axis=0))

        def drawn() -> Array:
            return np.concatenate([one.drawn(seed) for one in scored], axis=1)

        outputs = tuple(output_gains(base, part, kept, runs[0], runs[1], floor, seed, drawn))
    total, p_loss = float(np.sum(d)), 1.0 - p_gain
    gone = any(after and not before for before, after in (lost, away))
    decision = decide(p_gain, p_loss, total, outputs, gone)
    if n < FEWEST_ROWS:
        decision = Decision.LOSES if gone else Decision.NO_EVIDENCE
    worse = [o.output for o in runs_changed(outputs)[1]]
    if worse and p_gain > TEST_LEVEL:
        notes.append(
            f"The extended model simulates {enumerated(worse)} worse, and does not clearly predict better: "
            "what it has not seen does not speak for it."
        )
    return Gain(
        how=how,
        samples=n,
        log_density=total,
        per_sample=mean,
        standard_error=error,
        p_value=p_gain,
        p_loss=p_loss,
        outputs=outputs,
        decision=decision,
        notes=tuple(notes),
        t=np.asarray(part.t),
        y=np.where(kept[:, None], part.y, np.nan),
        before=None if away[0] else runs[0],
        after=None if away[1] else runs[1],
        d=np.where(kept, d, np.nan),
    )


def diebold_mariano(d: Array, rows: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Mean of d over the marked rows, its standard error, and the one-sided p-value of a mean <= 0.

    Student's t with n - 1 degrees of freedom, as Harvey, Leybourne and Newbold (1997) advise.
    """
    n = int(rows.sum())
    if n < 2 or not np.isfinite(d).all():
        return float("nan"), float("nan"), 0.5
    mean = float(d[rows].mean())
    marked = np.flatnonzero(rows)
    apart = int(np.gcd.reduce(np.diff(marked)))
    # rows between, of steps within a sample, would hide that d is correlated
    deviations = np.where(rows, d - mean, 0.0)[marked[0] :: apart]
    error = newey_west(deviations, n, lags_for(deviations)) * float(np.sqrt(n / (n - 1.0)))
    if not error > 0.0:
        return mean, error, 0.5 if mean == 0.0 else float(mean < 0.0)
    return mean, error, student_sf(mean / error, n - 1)


def lags_for(d: Array) -> int:
    """Lags of the Bartlett weights for d of correlation r: 1.1447 (alpha T)^(1/3), Andrews (1991).

    alpha = 4 r^2 / ((1 - r)^2 (1 + r)^2); never fewer than 4 (T / 100)^(2/9) nor more than a third of d.
    """
    T = len(d)
    power = float(d @ d)
    r = float(np.clip(d[1:] @ d[:-1] / power, 0.0, 0.97)) if power > 0.0 else 0.0
    alpha = 4.0 * r**2 / ((1.0 - r) ** 2 * (1.0 + r) ** 2)
    fewest = int(4.0 * (T / 100.0) ** (2.0 / 9.0))
    return min(max(fewest, int(1.1447 * (alpha * T) ** (1.0 / 3.0))), max(T // 3, 1))


def every_fifth(T: int, first: int = EVERY // 2) -> NDArray[np.bool_]:
    """The rows (T,) of every fifth of 25 blocks, from block ``first`` on."""
    block = np.arange(T) * BLOCKS // T if T >= 2 * BLOCKS else np.arange(T) // 2
    return np.asarray(block % EVERY == first)
