"""Whether several records have one set of parameters, or each has values of its own.

Persons, batches, cells, machines: what is fitted to all of them is none of them, and what common values get
wrong comes out as noise that changes with time, or as an effect that says it in part. So a parameter is given a
value for each record, all else is fitted anew, and both fits are compared. Noise takes what differs for its own
as long as there is one value, so a score beside the common fit tells next to nothing of what a fit will gain.

Of parameter p the records ask for as many values as D = diag(H_k,pp) - C H^{-1} C' has directions, where C has
the rows H_k,p of each record's information and H their sum: what parameters that all share may make up for is
taken away (Rao 1948).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.data.joined import apart
from engine.data.series import Series
from engine.diagnose.screening.noise_parameters import moves_on
from engine.distributions import f_sf
from engine.errors import EngineError
from engine.estimation.maximization import scoring_step
from engine.estimation.quasi_ml import DAMPING, QuasiFit, derivatives, log_likelihoods
from engine.statespace.model import Array
from engine.words import enumerated, number, probability

LEVEL = 1e-3  # of the p-value, by Bonferroni over parameters
FLAT = 1e-8  # of the largest: an eigenvalue below it is none
SURE = 3.0  # standard errors from zero, from which the sign of a size in a record is sure
STEPS = 12  # of a fit with a value for each record
LEAST = 0.05  # nats: a step that should gain less ends it
SHORTER = 6  # times that a step is halved
SHOWN = 12  # records whose values are told
CANNOT = (EngineError, np.linalg.LinAlgError)
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class OwnValues:
    """Parameters with a value for each record: ``values`` and ``errors`` (K, n) of the ``names``.

    ``p_value`` of one value for all, the largest of them; ``gain``, 2 x log-likelihood, of so many ``further``
    values. Errors are inf where a record tells nothing.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    errors: Array
    p_value: float
    gain: float
    further: int

    def of_both_signs(self, sizes: Sequence[str]) -> str:
        """One of the ``sizes`` that is surely above 0 in one record and below in another; "" without one."""
        for k, name in enumerate(self.names):
            away = self.values[:, k] / self.errors[:, k]
            if name in sizes and away.min() < -SURE and away.max() > SURE:
                return name
        return ""

    def in_words(self, numbers: Sequence[int]) -> str:
        """The values, by the ``numbers`` (K,) of the records."""
        order = np.argsort(numbers)
        shown = enumerated([str(numbers[k]) for k in order[:SHOWN]])
        more = "; those of further records are not shown" if len(order) > SHOWN else ""
        each = "; ".join(self._one(i, order[:SHOWN]) for i in range(len(self.names)))
        return f"in records {shown}, counted from 0, {each}{more}"

    def _one(self, i: int, order: NDArray[np.intp]) -> str:
        pairs = [(self.values[k, i], self.errors[k, i]) for k in order]
        told = [f"{number(v)} +- {number(e, 2)}" if np.isfinite(e) else "unknown" for v, e in pairs]
        return f"{self.names[i]} = {', '.join(told)} {self.units[i]}".rstrip()


@dataclass(frozen=True, eq=False)
class _Point:
    """Parameters (K, n_theta) of the records, their log-likelihood, scores (K, n), informations (K, n, n)."""

    thetas: Array
    value: float
    g: Array
    H: Array


@dataclass(frozen=True)
class Word:
    """A sentence on records that differ; ``refutes`` whether no name and no nothing holds beside it.

    ``short`` is what comes first of it, without the values.
    """

    sentence: str
    refutes: bool
    short: str


def word_of_records(
    before: QuasiFit,
    after: QuasiFit,
    series: Series,
    numbers: Sequence[int],
    named: Sequence[str],
    noises: Sequence[str],
    sizes: Sequence[str] = (),
    frequencies: Sequence[str] = (),
) -> Word | None:
    """What the records of ``series`` say of one set of parameters for all, beside what was ``named``.

    None where one will do. ``noises`` are those among the names that are of the noise: they are what such a
    difference looks like, and not trusted beside it. Another name is not where the records' own values alone
    explain more, by the measure of Schwarz (1978), nor where its size, among ``sizes``, has one sign in some
    records and surely the other one in others: what grows here and decays there is no cause of both. Nor is a
    wave where one of its ``frequencies`` is not the same in all.
    """
    own = own_values(after if named else before, series)
    if own is not None and noises:
        common = f"What common values get wrong looks like {enumerated([*noises])}, so no cause is named."
        return Word(f"{_said(own, numbers, named)} {common}", True, _in_short(own, named))
    if own is None and not named:
        return None
    said = "" if own is None else _said(own, numbers, named)
    short = "" if own is None else _in_short(own, named)
    if named:
        alone = own_values(before, series)
        gained = 0.0 if alone is None else alone.gain - _cost(alone.further, series)
        if alone is not None and gained > _worth(before, after, series):
            # beside a step in time, say, values are what that leaves
            said = (
                f"{_said(alone, numbers, ())} That explains more than {enumerated([*named])}, so no cause is "
                "named."
            )
            short = _in_short(alone, ())
        elif own is None:
            return None
        elif opposite := own.of_both_signs(sizes):
            either = (
                f"In some records {opposite} is surely above 0, in others below: no cause is named."
            )
            return Word(f"{said} {either}", True, short)
        elif not set(own.names).isdisjoint(frequencies):
            waves = "A wave that they share has one frequency, so no cause is named."
            return Word(f"{said} {waves}", True, short)
        else:
            common = "The sizes of what was found are those of a common fit."
            return Word(f"{said} {common}", False, short)
    return Word(
        f"{said} Either they differ, or something that the model lacks does: diagnose a record by itself, or "
        "make what is known to differ an input of the model.",
        True,
        short,
    )


def _said(own: OwnValues, numbers: Sequence[int], named: Sequence[str]) -> str:
    """The values that records have, beside what was ``named``."""
    return f"{_differ(own, named)}: {own.in_words(numbers)}."


def _in_short(own: OwnValues, named: Sequence[str]) -> str:
    return f"{_differ(own, named)}. The notes tell the value of each."


def _differ(own: OwnValues, named: Sequence[str]) -> str:
    beside = f" beside {enumerated([*named])}" if named else ""
    return (
        f"The records do not have the same {enumerated([*own.names])}{beside} "
        f"({probability(own.p_value)}; 2 x log-likelihood gained {number(own.gain)} by {own.further} values "
        "more)"
    )


def _worth(before: QuasiFit, after: QuasiFit, series: Series) -> float:
    """What an extension gains, less what its parameters cost."""
    further = len(after.free) - len(before.free)
    return 2.0 * (after.log_likelihood - before.log_likelihood) - _cost(further, series)


def _cost(further: int, series: Series) -> float:
    """What so many parameters more must gain (Schwarz 1978)."""
    return further * float(np.log(series.n_measured))


def own_values(fit: QuasiFit, series: Series) -> OwnValues | None:
    """Which parameters have values of their own in the records of ``series``; None where one holds for all.

    Those of the noise or the first state alone, tied ones and those at a bound are not asked: where it begins,
    and what noise it has, is a record's own anyhow. One is added after the other, the clearest first.
    """
    records = apart(series)
    if len(records) < 2:
        return None
    try:
        return _Asking(fit, records, series).answer()
    except CANNOT:
        return None


class _Asking:
    def __init__(self, fit: QuasiFit, records: Sequence[Series], series: Series) -> None:
        self.fit, self.records, self.model = fit, records, fit.model
        self.indices = fit.model.free_indices(fit.free)
        self.rows = int(series.observed.sum())
        bound = np.isin(fit.free, fit.model.at_bounds(fit.theta, fit.free))
        self.asked: Mask = ~bound & ~np.isin(fit.free, fit.tied) & moves_on(fit, series)

    def answer(self) -> OwnValues | None:
        start = now = self._at(np.tile(np.asarray(self.fit.theta), (len(self.records), 1)))
        own, worst = np.zeros(len(self.indices), dtype=bool), 0.0
        while np.isfinite(now.value) and (best := self._next(now, own)) is not None:
            own, now, worst = best[0], best[1], max(worst, best[2])
        if not own.any():
            return None
        chosen, names = np.flatnonzero(own), [self.fit.free[p] for p in np.flatnonzero(own)]
        with np.errstate(divide="ignore"):
            errors = 1.0 / np.sqrt(np.maximum(now.H[:, chosen, chosen], 0.0))
        return OwnValues(
            tuple(names),
            tuple(self.model.parameters[self.model.index(name)].unit for name in names),
            now.thetas[:, self.indices[chosen]],
            errors,
            worst,
            2.0 * (now.value - start.value),
            len(chosen) * (len(self.records) - 1),
        )

    def _next(self, now: _Point, own: Mask) -> tuple[Mask, _Point, float] | None:
        """The parameter that gains most by own values beside those that have them, if one does surely."""
        tried = []
        for p in np.flatnonzero(self.asked & ~own).tolist():
            freedom = values_told(now.H, p, own)
            if not freedom:
                continue
            more = own.copy()
            more[p] = True
            there = self._fitted(now, more)
            gain = 2.0 * (there.value - now.value)
            left = self.rows - len(own) - int(own.sum()) * (len(self.records) - 1) - freedom
            p_value = float(self.asked.sum()) * of_gain(gain, freedom, self.rows, left)
            if p_value <= LEVEL:
                tried.append((more, there, min(p_value, 1.0)))
        return min(tried, key=lambda one: (one[2], -one[1].value), default=None)

    def _at(self, thetas: Array) -> _Point:
        each = [
            derivatives(self.model, [one], theta, self.indices)
            for one, theta in zip(self.records, thetas, strict=True)
        ]
        value, g, H = (np.array([one[i] for one in each]) for i in range(3))
        return _Point(thetas, float(value.sum()), g, H)

    def _fitted(self, start: _Point, own: Mask) -> _Point:
        """The highest point with a value for each record of the parameters that are ``own``."""
        now = start
        for _ in range(STEPS):
            x, g, H = self._stacked(now, own)
            low, high = (
                self._spread(b[self.indices], own) for b in (self.model.lower, self.model.upper)
            )
            direction = scoring_step(x, g, H, low, high, DAMPING)
            if not float(g @ direction) > LEAST:
                break
            for k in range(SHORTER):
                moved = np.clip(x + 0.5**k * direction, low, high)
                thetas = self._thetas(now.thetas, moved, own)
                if self._value(thetas) > now.value:
                    break
            else:
                break
            there = self._at(thetas)
            if not np.isfinite(there.value):
                break
            now, gained = there, there.value - now.value
            if gained < LEAST:
                break
        return now

    def _value(self, thetas: Array) -> float:
        pairs = zip(self.records, thetas, strict=True)
        return float(sum(log_likelihoods(self.model, [one], at[None])[0] for one, at in pairs))

    def _spread(self, common: Array, own: Mask) -> Array:
        """A number for each free parameter, as one for each unknown: shared ones, then each record's."""
        return np.concatenate([common[~own], np.tile(common[own], len(self.records))])

    def _stacked(self, now: _Point, own: Mask) -> tuple[Array, Array, Array]:
        """Unknowns, their score and information."""
        n, m = int((~own).sum()), int(own.sum())
        at = now.thetas[:, self.indices]
        x = np.concatenate([at[0, ~own], at[:, own].ravel()])
        g = np.concatenate([now.g[:, ~own].sum(axis=0), now.g[:, own].ravel()])
        H = np.zeros((len(x), len(x)))
        H[:n, :n] = now.H[:, ~own][:, :, ~own].sum(axis=0)
        for k, one in enumerate(now.H):
            place = slice(n + k * m, n + (k + 1) * m)
            H[place, place] = one[np.ix_(own, own)]
            H[:n, place] = one[np.ix_(~own, own)]
            H[place, :n] = H[:n, place].T
        return x, g, H

    def _thetas(self, before: Array, x: Array, own: Mask) -> Array:
        n, out = int((~own).sum()), before.copy()
        out[:, self.indices[~own]] = x[:n]
        out[:, self.indices[own]] = x[n:].reshape(len(self.records), -1)
        return out


def of_gain(gain: float, freedom: int, rows: int, left: int) -> float:
    """The p-value of 2 x log-likelihood gained by so many values more, with ``left`` degrees of freedom.

    Noise is fitted as well, and beside many values of few rows it is small by chance: of a linear regression
    this is exact, and of many rows it is chi-squared.
    """
    if not gain > 0.0 or left < 1:
        return 1.0
    with np.errstate(over="ignore"):  # beyond all numbers nothing is chance
        ratio = float(np.expm1(gain / rows))
    return f_sf(ratio * left / freedom, freedom, left)


def values_told(H: Array, p: int, own: Mask) -> int:
    """How many values more the records tell of parameter p, beside those that are ``own``; 0 for one alone.

    ``H`` (K, n, n) is the information of each record.
    """
    told = H[:, p, p] > 0.0
    if told.sum() < 2:
        return 0
    shared = ~own
    scale = np.sqrt(np.maximum(np.einsum("kii->i", H), 0.0))
    inverse = np.where(scale > 0.0, 1.0 / np.where(scale > 0.0, scale, 1.0), 0.0)
    H = H * inverse[:, None] * inverse
    if own.any():  # a record's own values are moved by itself
        back = np.linalg.pinv(H[:, own][:, :, own], rcond=FLAT, hermitian=True)
        H = H - H[:, :, own] @ back @ H[:, own]
        told &= H[:, p, p] > FLAT * H[:, p, p].max(initial=0.0)
    common = np.linalg.pinv(H[:, shared][:, :, shared].sum(axis=0), rcond=FLAT, hermitian=True)
    C = H[told, p][:, shared] / np.sqrt(H[told, p, p])[:, None]
    return int((np.linalg.eigvalsh(np.eye(len(C)) - C @ common @ C.T) > FLAT).sum())
