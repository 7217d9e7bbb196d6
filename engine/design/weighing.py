"""What inputs are worth: how surely a diagnosis names each cause, and in how many samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.arrays import Array
from engine.design.alarm import Alarm
from engine.design.candidates import Question
from engine.design.contest import Contest, contest, demand_of
from engine.design.design import Experiment, Undecided, hardest, hopeless_pairs
from engine.design.inputs import Plan
from engine.design.runs import simulated
from engine.design.search import Pair, Search, Task, Tried, search
from engine.design.sensors import sensors
from engine.diagnose.records import LEAST
from engine.diagnose.refits.checkpoint import NOTHING, Kept
from engine.errors import OptionError

LEVEL = 0.95  # the probability of the right name that is wanted
ENOUGH = 14.5  # D that reaches it against one rival: (D - 2) / (2 sqrt D) = 1.645
FAR = 50.0  # times the length asked: what would need more is not told apart by any input
LEADERS = 2  # of the search, weighed with rivals that adapt
ROWS_EACH = 10  # samples for each parameter that is estimated, at least
LENGTHS = 12  # at which the probability is given
SHORTER = 0.5  # of a length that reaches the level: the next one tried
LONGER = 1.3  # of one that does not, at the end
FEWER = 0.3  # of the inputs, for each length that is tried
LATER = (1.0, 1.03, 1.1, 1.25)  # times where the level is reached: where an input is cut off

Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Weighed:
    """An input with its contests, one for each true cause."""

    plan: Plan
    points: dict[Pair, Array]
    contests: tuple[Contest, ...]
    experiment: Experiment


@dataclass(frozen=True, eq=False)
class Weighing:
    """Of the inputs that a search has found for a question; what further searches find is ``kept``."""

    task: Task
    question: Question
    seed: int
    kept: Kept = NOTHING

    def best(self, state: Search, undecided: Sequence[Undecided]) -> Weighed:
        """The best of the leading inputs once rivals adapt: by the least probability, then the least D."""
        hopeless = hopeless_pairs(undecided)
        weighed = [self.weighed(one, hopeless) for one in state.leaders[:LEADERS]]
        return max(
            weighed, key=lambda one: (round(one.experiment.least, 3), self._least(one, hopeless))
        )

    def weighed(self, one: Tried, hopeless: set[frozenset[str]]) -> Weighed:
        """An input with its probabilities."""
        task, candidates = self.task, self.question.candidates
        task = replace(task, length=len(one.u))
        experiment = task.experiments(one.u[None])
        seen = task.measured(experiment)
        contests = tuple(
            contest(i, candidates, self.question.base, experiment, seen, task.anew, starts)
            for i, starts in enumerate(self._starts(one))
        )
        T, m = len(one.u), len(candidates)
        D = np.zeros((m, m))
        for i, own in enumerate(contests):
            D[i, [j for j in range(m) if j != i]] = own.distance(self._rows(T))[:-1]
        made = Experiment(
            one.u, D, self._named(contests, T, hopeless), " and ".join(s.family for s in one.plan)
        )
        return Weighed(one.plan, one.points, contests, made)

    def _starts(self, one: Tried) -> list[dict[str, Array]]:
        """For each true cause the parameters of its rivals that were found before, by their names."""
        candidates = self.question.candidates
        return [
            {candidates[j].name: p for (true, j), p in one.points.items() if true == i}
            for i in range(len(candidates))
        ]

    def _rows(self, n: int) -> int:
        """Rows of the runs up to the n-th sample."""
        return (n - 1) * self.task.substeps + 1

    def _named(self, contests: Sequence[Contest], n: int, hopeless: set[frozenset[str]]) -> Array:
        """Probability (m,) of each true cause to win in n samples, against rivals that inputs tell apart."""
        out = []
        for i, one in enumerate(contests):
            demand = demand_of(i, self.question.candidates, n, self.task.anew)
            alike = [frozenset((one.name, rival.name)) in hopeless for rival in one.rivals[:-1]]
            if all(alike):
                out.append(0.0)
                continue
            alarm = Alarm(self.question.alarm)
            out.append(one.probability(self._rows(n), demand.but(alike), alarm, self.seed))
        return np.array(out)

    def _least(self, one: Weighed, hopeless: set[frozenset[str]]) -> float:
        names = [c.name for c in self.question.candidates]
        return hardest(names, one.experiment.D, hopeless)[1]

    def undecided(self, state: Search, inputs: int, progress: Progress) -> list[Undecided]:
        """Pairs that no input has told apart so far, each searched for on its own."""
        out, names = [], [c.name for c in self.question.candidates]
        for k, (i, j) in enumerate(sorted(state.dead)):
            best = state.refined(state.by[i, j])
            best = state.improved(best, max(inputs // 4, 1), [(i, j)])
            D = state.worth(best, [(i, j)])
            if D < ENOUGH / FAR:
                found = tuple(sensors(self.task, best.u, i, j))
                out.append(Undecided((names[j], names[i]), D, None, found))
            else:
                state.leaders.append(best)
            progress((k + 1) / len(state.dead))
        return out

    def settled(self, undecided: Sequence[Undecided], best: Weighed) -> list[Undecided]:
        """Those that no input tells apart, and those that need a longer record."""
        out, names = list(undecided), [c.name for c in self.question.candidates]
        known, D, T = hopeless_pairs(undecided), best.experiment.D, len(best.experiment)
        for i, one in enumerate(names):
            for j, other in enumerate(names[:i]):
                least = float(min(D[i, j], D[j, i]))
                if frozenset((one, other)) in known or least >= ENOUGH:
                    continue
                if least < ENOUGH / FAR:
                    found = tuple(sensors(self.task, best.experiment.u, i, j))
                    out.append(Undecided((one, other), least, None, found))
                else:
                    needed = int(np.ceil(T * ENOUGH / least))
                    out.append(Undecided((one, other), least, needed))
        return out

    @property
    def shortest_length(self) -> int:
        """Samples below which no probability is given: so few do not tell so many parameters."""
        most = max(len(c.free) for c in self.question.candidates)
        return min(max(LEAST, ROWS_EACH * most), self.task.length)

    def shortest(
        self, best: Weighed, inputs: int, undecided: Sequence[Undecided], progress: Progress
    ) -> Experiment | None:
        """The shortest experiment that reaches the level: searches of its own for shorter and shorter ones."""
        hopeless = hopeless_pairs(undecided)
        reached = self._prefix(best, hopeless)
        if reached is None:
            return None
        factor, k = SHORTER, 0
        while True:
            k += 1
            progress(1.0 - 0.7**k)
            n = max(int(np.ceil(factor * len(reached.experiment))), self.shortest_length)
            if n >= len(reached.experiment):
                return reached.experiment
            found = self._within(n, reached.plan, best.plan, inputs, k, hopeless)
            shorter = None if found is None else self._prefix(found, hopeless)
            if shorter is not None:
                reached = shorter
            elif factor > SHORTER:
                return reached.experiment
            else:
                factor = SHORTER * LONGER

    def _within(
        self, n: int, plan: Plan, other: Plan, inputs: int, k: int, hopeless: set[frozenset[str]]
    ) -> Weighed | None:
        """The best input of n samples; None where none keeps the limits."""
        task = replace(self.task, length=n)
        own = replace(self, task=task)
        try:
            state = search(
                task,
                max(int(FEWER * inputs), 1),
                self.seed + 1000 * k,
                lambda share: None,
                known=[plan, other],
                kept=self.kept.within(f"length {k}"),
            )
        except OptionError:
            return None
        if not state.leaders:
            return None
        weighed = [own.weighed(one, hopeless) for one in state.leaders[:2]]
        return max(weighed, key=lambda one: one.experiment.least)

    def growth(self, one: Weighed, undecided: Sequence[Undecided]) -> Array:
        """Samples, and the probability of each cause in a record of so many (k, 1 + m)."""
        grid = np.geomspace(self.shortest_length, len(one.experiment), LENGTHS)
        lengths, hopeless = sorted({round(float(n)) for n in grid}), hopeless_pairs(undecided)
        return np.array([[n, *self._named(one.contests, n, hopeless)] for n in lengths])

    def reach(self, one: Weighed, hopeless: set[frozenset[str]]) -> int | None:
        """The samples of an input that reach the level; None where all of them do not."""
        if one.experiment.least < LEVEL:
            return None
        low, high = self.shortest_length - 1, len(one.experiment)
        while high - low > max(1, high // 50):
            n = (low + high) // 2
            if self._named(one.contests, n, hopeless).min() >= LEVEL:
                high = n
            else:
                low = n
        return high

    def _prefix(self, one: Weighed, hopeless: set[frozenset[str]]) -> Weighed | None:
        """The input cut off where it reaches the level; None where it does not.

        A rival that adapts to less data may be nearer: then it is cut off a little later.
        """
        high = self.reach(one, hopeless)
        if high is None:
            return None
        u = one.experiment.u
        for share in LATER:
            n = int(np.ceil(share * high))
            if n >= len(u):
                break
            if self.task.leaked(u[:n])[0] > 0.0:
                continue  # cut off there it would excite a stop band
            cut = self.weighed(Tried(one.plan, u[:n], np.zeros((0, 0)), 0.0, one.points), hopeless)
            if cut.experiment.least >= LEVEL:
                return cut
        return one

    def predictions(self, u: Array) -> Array:
        """The outputs (m, T, ny) that each cause predicts."""
        experiment = self.task.experiments(u[None])
        runs = [simulated(c.model, c.theta, experiment)[0] for c in self.question.candidates]
        return np.array([y[0, experiment.rows] for y in runs])
