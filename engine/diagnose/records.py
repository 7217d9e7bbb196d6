"""One record or several: those that are alike are searched together, and the longest is what is shown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.arrays import Array
from engine.data.given import as_series_list, check_apart, same_clock
from engine.data.joined import by_length, distances, in_turn, overlapping, together
from engine.data.series import Series
from engine.diagnose.effects.clock import reads_no_clock
from engine.diagnose.effects.spare_inputs import with_inputs
from engine.errors import OptionError, SeriesError
from engine.statespace.model import MixedModel
from engine.words import enumerated

LEAST = 30  # measured rows without which nothing can be said
HELD_OUT = 0.2  # share of the longest record kept back where no test series is given
MOST = 0.5  # of it
FEWEST_ROWS = 8  # held out, below which neighbours say nothing of a gain or a loss
# Why a record is not searched beside the longest.
OTHER_STEPS = "sampled at other steps, or with inputs held otherwise"
TOO_LONG = "too long for that"
ELSEWHERE = "elsewhere at first than the covariance of the model's initial state allows"
LEFT_OUT = (OTHER_STEPS, TOO_LONG, ELSEWHERE)
ON_TIME = 1e-6  # of a step, by which steps or times of two records may differ and be the same


@dataclass(frozen=True, eq=False)
class Records:
    """The ``main`` record, ``others``, and held-out ``tests``; each begins at a state of its own.

    ``share`` of the main record is kept back where there are no tests. ``kept_back`` are those of the records
    given that are tests as no others were; ``numbers`` tells which were given as the main one and the others.
    Where ``others_as_given`` are there, the others are on another clock than that, on which no two overlap.
    """

    main: Series
    others: tuple[Series, ...] = ()
    tests: tuple[Series, ...] = ()
    share: float = HELD_OUT
    kept_back: tuple[int, ...] = ()
    numbers: tuple[int, ...] = (0,)
    others_as_given: tuple[Series, ...] = ()

    @property
    def in_turn(self) -> bool:
        """Whether the others are on another clock than they were given on."""
        return bool(self.others_as_given)

    def as_given(self) -> Records:
        """All on the clocks that they were given on."""
        if not self.in_turn:
            return self
        return replace(self, others=self.others_as_given, others_as_given=())

    @property
    def every(self) -> tuple[Series, ...]:
        """The main record, the others, the tests."""
        return (self.main, *self.others, *self.tests)

    @property
    def train(self) -> Series:
        """The main record, without the part of it that is held out."""
        return self.main.part(0, self._cut) if self.keeps_back else self.main

    @property
    def held_out(self) -> tuple[Series, ...]:
        """The tests, or the main record's last part; none where nothing is kept back."""
        return (self.main.part(self._cut, len(self.main)),) if self.keeps_back else self.tests

    @property
    def keeps_back(self) -> bool:
        """Whether the main record's last part is not searched."""
        return not self.tests and self.share > 0.0

    def searched(self, fits: Callable[[Series], bool], most: int) -> tuple[Series, dict[str, int]]:
        """What the likelihood searches: the main record, and behind it the others that are sampled alike.

        Each begins at a first state of its own, which must be one of the model's, as ``fits`` says. The longest
        come first, up to ``most`` samples in all. Also how many others are left out, by the reason.
        """
        taken, left = [self.train.held(self.main.hold)], dict.fromkeys(LEFT_OUT, 0)
        for one in sorted(self.others, key=len, reverse=True):
            if one.hold != self.main.hold or not _same_step(one, self.main):
                left[OTHER_STEPS] += 1
            elif sum(map(len, taken)) + len(one.samples) > most:
                left[TOO_LONG] += 1
            elif not fits(one):
                left[ELSEWHERE] += 1
            else:
                taken.append(one.held(one.hold))
        there = {reason: n for reason, n in left.items() if n}
        if len(taken) == 1:
            return self.train, there
        return together(taken).refined(self.main.substeps), there

    def numbers_of(self, parts: Sequence[Series]) -> list[int]:
        """Which of the records given each of the ``parts`` that are searched is; -1 for one that is none."""
        given = zip(self.numbers, (self.main, *self.others), strict=True)
        every = [(n, one.y[one.samples]) for n, one in given]
        return [_number(part.y[part.samples], every) for part in parts]

    def check_enough(self, searched: Series, left: Mapping[str, int]) -> None:
        """Raise SeriesError where too few rows of all these can be searched together; says why."""
        rows = self.main.n_measured - self.train.n_measured + searched.n_measured
        if rows < LEAST and left:
            raise SeriesError(
                f"of {1 + len(self.others)} records the likelihood can search {1 + len(searched.begins)} "
                f"together, with {rows} rows that hold a measurement; at least {LEAST} are needed. "
                f"{others_left(left)}"
            )

    @property
    def _cut(self) -> int:
        samples = len(self.main.samples)
        return self.main.substeps * (samples - _kept_rows(samples, self.share))

    def refined(self, k: int) -> Records:
        """With k steps from each sample to the next."""
        return replace(
            self,
            main=self.main.refined(k),
            others=tuple(one.refined(k) for one in self.others),
            others_as_given=tuple(one.refined(k) for one in self.others_as_given),
            tests=tuple(one.refined(k) for one in self.tests),
        )


def _number(y: Array, every: Sequence[tuple[int, Array]]) -> int:
    """The number of the record whose first readings are ``y``."""
    return next((n for n, one in every if np.array_equal(one[: len(y)], y, equal_nan=True)), -1)


def others_left(left: Mapping[str, int]) -> str:
    """A sentence on the records that are left out, so many for each reason."""
    if len(left) == 1:
        (reason,) = left
        return f"The others are {reason}."
    parts = [f"{n} {'is' if n == 1 else 'are'} {reason}" for reason, n in left.items()]
    return f"Of the others {enumerated(parts)}."


def records_of(
    model: MixedModel,
    series: Series | Sequence[Series],
    test: Series | Sequence[Series] | None,
    held_out: float = HELD_OUT,
) -> tuple[MixedModel, Records]:
    """The records, and the model with extra channels of theirs as inputs. Raises SeriesError, OptionError.

    Refined series of a model whose steps are chosen here are taken by their samples.
    """
    wanted = isinstance(test, Series) or bool(test)
    check_held_out(held_out, wanted)
    given = _by_samples(model, as_series_list(series, model))
    tests = (
        _by_samples(model, as_series_list(test, model, "test"))
        if test is not None and wanted
        else []
    )
    same_clock([*given, *tests])
    names = given[0].extra_names
    for k, one in enumerate(given):
        if one.extra_names != names:
            raise SeriesError(
                f"record {k} has the extra channels {', '.join(one.extra_names) or 'none'}, record 0 "
                f"{', '.join(names) or 'none'}; all records need the same"
            )
    model = with_inputs(model, names)
    check_apart(given, tests)
    back = () if tests else whole_records(given, held_out)
    tests += [given[k] for k in back]
    on_one, moved = on_one_clock(model, given)
    numbers = tuple(k for k in by_length(on_one) if k not in back)
    main, *others = (on_one[k].with_extra_inputs() for k in numbers)
    as_given = (*(timed_like(given[k], main).with_extra_inputs() for k in numbers[1:] if moved),)
    apart = tuple(one.with_extra_inputs().check(model) for one in tests)
    return model, Records(main, tuple(others), apart, held_out, back, numbers, as_given)


def timed_like(one: Series, main: Series) -> Series:
    """A record at the times of the ``main`` one where they are the same but for rounding.

    Else what comes at a time of the one comes a sample later in the other.
    """
    after = np.clip(np.searchsorted(main.t, one.t), 1, len(main) - 1)
    ends = main.t[after - 1], main.t[after]
    nearest = np.where(one.t - ends[0] < ends[1] - one.t, *ends)
    same = np.abs(nearest - one.t) <= ON_TIME * main.usual_step
    return one.replace(t=np.where(same, nearest, one.t))


def on_one_clock(model: MixedModel, given: list[Series]) -> tuple[list[Series], bool]:
    """The records, in turn where their clocks overlap and the model reads none; whether they are.

    What comes once, in one of them, has a time of its own then. Tests keep theirs: a drift counts anew there.
    """
    moved = in_turn(given)
    if not overlapping(given) or not reads_no_clock(model, given, moved):
        return given, False
    return moved, True


def whole_records(given: Sequence[Series], share: float) -> tuple[int, ...]:
    """Which of many records are held out whole: a ``share`` of their number, never the longest.

    Of many short ones the last part of the longest tells little: all may have settled there. They are those
    that stand for all others best, by the levels of their readings, in whatever order they come. Empty where
    the share of their number is none, where that part holds more rows, or where too few would be left. Where
    that part can tell nothing at all, fewer are enough.
    """
    rows, (longest, *rest) = [one.n_measured for one in given], by_length(given)
    n = int(share * len(given) + 1e-9)
    if not n:
        return ()
    back = tuple(rest[j] for j in _standing_for_all([given[k] for k in rest], n))
    held = sum(rows[k] for k in back)
    telling = _kept_rows(rows[longest], share) >= FEWEST_ROWS
    enough = 2 * LEAST if telling or held < FEWEST_ROWS else LEAST
    return back if held >= share * rows[longest] and sum(rows) - held >= enough else ()


def _kept_rows(samples: int, share: float) -> int:
    """How many of the longest record's last samples are kept back: a share, but so many that they can tell.

    A share below the default one was asked for, and stays. Where those that can tell would be more than half of
    the record, none can, and the share is all that the search is deprived of.
    """
    asked = max(int(share * samples), 2)
    can_tell = share >= HELD_OUT and MOST * samples >= FEWEST_ROWS
    return max(asked, FEWEST_ROWS) if can_tell else asked


def _standing_for_all(given: Sequence[Series], n: int) -> list[int]:
    """So many of the records that the others' distances to the nearest of them are least, chosen one by one."""
    far = distances(given)
    chosen, nearest = list[int](), np.full(len(given), np.inf)
    for _ in range(n):
        left = np.minimum(nearest, far).sum(axis=1)
        left[chosen] = np.inf
        chosen.append(int(np.argmin(left.round(6))))
        nearest = np.minimum(nearest, far[chosen[-1]])
    return chosen


def _same_step(one: Series, other: Series) -> bool:
    """Whether both are sampled at one step, or neither at any."""
    if one.dt is None or other.dt is None:
        return one.dt is other.dt
    return abs(one.dt / other.dt - 1.0) < ON_TIME


def _by_samples(model: MixedModel, given: Sequence[Series]) -> list[Series]:
    chosen = model.continuous and not model.steps_counted
    return [one.held(one.hold) if chosen and one.substeps > 1 else one for one in given]


def check_held_out(held_out: float, tested: bool) -> None:
    """Raise OptionError where the share is none, or is given beside a test series."""
    if not 0.0 <= held_out <= MOST:
        raise OptionError(
            f"held_out = {held_out:g} is not within 0 to {MOST:g}: it is the share of the longest record, or "
            "of many, that is kept back from the search, and 0 keeps nothing back",
            "held_out",
        )
    if tested and held_out != HELD_OUT:
        raise OptionError(
            f"held_out = {held_out:g} is given beside test, which is what is held out then: give one of them",
            "held_out",
        )


def check_searched(series: Series, others: Sequence[Series] = ()) -> None:
    """Raise SeriesError where records are too short to be searched, or an output of the longest is dead."""
    rows = series.n_measured + sum(one.n_measured for one in others)
    if rows < LEAST:
        raise SeriesError(
            f"only {rows} rows hold a measurement; a diagnosis needs at least {LEAST}, of all records "
            "together, as it fits the model, tests dozens of effects beside its parameters, and keeps rows "
            "back to judge what it finds: give a longer record, or more of them"
        )
    for name, y in zip(series.y_names, series.y.T, strict=True):
        seen = y[~np.isnan(y)]
        if len(seen) > 1 and seen.min() == seen.max():
            raise SeriesError(
                f"output '{name}' reads {seen[0]:g} throughout: a dead channel carries no information; "
                "give its readings as NaN, or leave the output out of the model"
            )
