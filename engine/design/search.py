"""The search for an input: random starts of every family, then one number of the best at a time.

What is maximised is the least D over all pairs of causes that some input told apart so far; an input that
breaks a limit counts by how far it does. Inputs are tried in batches, for a batch of runs costs little more
than one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from engine.design.bounds import Bounds
from engine.design.candidates import Candidate
from engine.design.criterion import adapted, linear_distances, precision
from engine.design.inputs import FAMILIES, LEAK, Plan, drawn_plan, leakage, played
from engine.design.runs import Experiments, Runs, linearised, simulated
from engine.diagnose.refits.checkpoint import NOTHING, Kept
from engine.errors import OptionError
from engine.kernels.whitening import spread
from engine.statespace.model import Array

BATCH = 16  # inputs that are tried at once
REFINED = 4  # starts whose rivals adapt
STARTS = 0.4  # of the inputs, drawn at random
KEPT = 3  # of them that are gone on with in turn
ALIVE = 0.3  # D from which on a pair is one that inputs tell apart
NEAR = 0.15  # of the range: a small move of a number, every other one

Progress = Callable[[float], None]


Pair = tuple[int, int]  # the true cause and its rival


@dataclass(frozen=True, eq=False)
class Tried:
    """An input that was tried: its plan, u (T, nu), D (m, m), and by how much it breaks a limit.

    ``points`` are the rivals' parameters about which D is linear, by pair; of one that is ``refined`` the
    rivals have adapted, and D is not linear any more.
    """

    plan: Plan
    u: Array
    D: Array
    violation: float
    points: dict[Pair, Array]
    refined: bool = False


@dataclass(frozen=True, eq=False)
class Task:
    """What inputs are searched for: causes, bounds, length, and how a new record is diagnosed.

    ``hold`` and ``substeps`` are those of the diagnosed record; ``seen`` (ny,) the outputs that are measured.
    """

    candidates: tuple[Candidate, ...]
    bounds: Bounds
    length: int
    dt: float
    hold: str
    substeps: int
    seen: NDArray[np.bool_]
    anew: bool

    @property
    def limits(self) -> tuple[str, ...]:
        """What an input may break, by the fields of the bounds; first that it breaks nothing."""
        own = self.bounds
        return (
            "",
            *(f"bounds.states.{name}" for name in own.states),
            *(f"bounds.outputs.{name}" for name in own.outputs),
            *(f"bounds.inputs.{name}.stopbands" for name in own.inputs),
        )

    def experiments(self, u: Array) -> Experiments:
        """Of inputs (B, T, nu)."""
        return Experiments.of(u, self.dt, self.hold, self.substeps)

    def measured(self, experiments: Experiments) -> NDArray[np.bool_]:
        """Which readings there are (n, ny)."""
        out = np.zeros((len(experiments.t), len(self.seen)), dtype=bool)
        out[experiments.rows] = self.seen
        return out

    def play(self, plan: Plan) -> Array:
        """The inputs (T, nu) of a plan."""
        names = self.candidates[0].model.inputs
        own = [self.bounds.inputs[name] for name in names]
        return played(plan, own, self.length, self.dt)

    def leaked(self, u: Array) -> tuple[float, str]:
        """What an input (T, nu) has in its stop bands beyond what may be left there, at most, and where."""
        worst, where = 0.0, ""
        for i, name in enumerate(self.candidates[0].model.inputs):
            over = leakage(u[:, i], self.bounds.inputs[name], self.dt) - LEAK
            if over > worst:
                worst, where = over, f"bounds.inputs.{name}.stopbands"
        return worst, where


@dataclass(eq=False)
class Search:
    """Inputs tried so far, the best first in ``leaders``.

    ``points`` are the rivals' parameters about which the next inputs' D is linear. ``dead`` are pairs that no
    input has told apart once the rival had adapted; ``by`` is the best input for each pair on its own.
    ``kept`` is what an interrupted search found, in the order in which it is asked again.
    """

    task: Task
    rng: np.random.Generator
    kept: Kept = NOTHING
    asked: int = 0
    points: dict[Pair, Array] = field(default_factory=dict)
    active: list[list[int]] = field(default_factory=list)
    by: dict[Pair, Tried] = field(default_factory=dict)
    dead: set[Pair] = field(default_factory=set)
    tried: int = 0
    nearest: tuple[float, str] = (np.inf, "")
    leaders: list[Tried] = field(default_factory=list)

    def __post_init__(self) -> None:
        candidates = self.task.candidates
        self.precisions = [precision(c, self.task.anew) for c in candidates]
        self.active = [c.indices for c in candidates]
        self.points = {(i, j): candidates[j].theta for i, j in self.ordered()}

    def ordered(self) -> list[Pair]:
        """All pairs, each both ways round."""
        m = len(self.task.candidates)
        return [(i, j) for i in range(m) for j in range(m) if i != j]

    def once(self) -> list[Pair]:
        """All pairs (i, j), i > j."""
        return [(i, j) for i, j in self.ordered() if i > j]

    def pairs(self) -> list[Pair]:
        """Pairs that count: not those that no input has told apart, unless all are such."""
        return [pair for pair in self.once() if pair not in self.dead] or self.once()

    def evaluate(self, plans: Sequence[Plan]) -> list[Tried]:
        """Each plan's input with its D and what it breaks."""
        u = np.array([self.task.play(plan) for plan in plans])
        if not self.tried:
            self._leave_out(self.task.experiments(u))
        found = self._once(partial(self._worths, u))
        m = len(self.task.candidates)
        D, broken = found[:, : m * m].reshape(-1, m, m), found[:, -2]
        which = [self.task.limits[int(k)] for k in found[:, -1]]
        out = []
        for k, plan in enumerate(plans):
            one = Tried(plan, u[k], D[k], float(broken[k]), dict(self.points))
            if one.violation < self.nearest[0]:
                self.nearest = one.violation, which[k]
            if one.violation <= 0.0:
                self.by |= {pair: one for pair in self.once() if self._is_better(one, pair)}
            out.append(one)
        self.tried += len(plans)
        return out

    def _once(self, compute: Callable[[], Array]) -> Array:
        """The next of the arrays that take the time, or as it was kept."""
        self.asked += 1
        return self.kept.numbers(f"{self.asked}", compute)

    def _worths(self, u: Array) -> Array:
        """Of inputs (B, T, nu): D, row by row, by how much a limit is broken, and which (B, m m + 2)."""
        task = self.task
        experiments = task.experiments(u)
        seen = task.measured(experiments)
        D = np.zeros((len(u), len(task.candidates), len(task.candidates)))
        truths, broken, which = self._truths(experiments)
        for b, one in enumerate(u):
            over, where = task.leaked(one)
            if over > broken[b]:
                broken[b], which[b] = over, where
        for i, j in self.ordered():
            rival, own = task.candidates[j], self.active[j]
            runs = linearised(rival.model, self.points[i, j], experiments, own)
            places = [rival.indices.index(k) for k in own]
            held = self.precisions[j][np.ix_(places, places)]
            away = (self.points[i, j] - rival.theta)[own]
            own_D = linear_distances(truths[i], runs, held, away, seen)
            broken[runs.lost | np.isnan(own_D)] = np.inf
            D[:, i, j] = np.nan_to_num(own_D)
        number = [float(task.limits.index(name)) for name in which]
        return np.column_stack([D.reshape(len(u), -1), broken, number])

    def _is_better(self, one: Tried, pair: Pair) -> bool:
        known = self.by.get(pair)
        return known is None or self.worth(one, [pair]) > self.worth(known, [pair])

    def _truths(self, experiments: Experiments) -> tuple[list[Array], Array, list[str]]:
        """The readings that each cause predicts, by how much (B,) limits are broken, and where."""
        task = self.task
        if task.bounds.states or task.bounds.outputs:
            runs = [linearised(c.model, c.theta, experiments, ()) for c in task.candidates]
            broken, which = violations(task, runs)
            for one in runs:
                broken[one.lost] = np.inf
            return [one.y for one in runs], broken, which
        B = len(experiments.u)
        truths, broken = [], np.zeros(B)
        for c in task.candidates:
            y, _ = simulated(c.model, c.theta, experiments)
            lost = ~np.isfinite(y).all(axis=(1, 2))
            broken[lost], y[lost] = np.inf, 0.0
            truths.append(y)
        return truths, broken, [""] * B

    def _leave_out(self, experiments: Experiments) -> None:
        """Parameters of the noise do not move a run."""
        for j, c in enumerate(self.task.candidates):
            moved = (linearised(c.model, c.theta, experiments, c.indices).dy != 0.0).any((0, 1, 2))
            self.active[j] = [k for k, moves in zip(c.indices, moved, strict=True) if moves]

    def worth(self, one: Tried, pairs: Sequence[Pair] | None = None) -> float:
        """The least D over the pairs that count, or those named; less than 0 beyond a limit."""
        if one.violation > 0.0:
            return -one.violation
        every = self.pairs() if pairs is None else pairs
        return float(min(min(one.D[i, j], one.D[j, i]) for i, j in every))

    def refined(self, one: Tried) -> Tried:
        """An input with the D that is left once all rivals have adapted, and their parameters there."""
        if one.refined or one.violation > 0.0:
            return one
        candidates = self.task.candidates
        m = len(candidates)
        found = self._once(partial(self._adapted, one))
        ends = np.cumsum([m * m, *(len(candidates[j].theta) for _, j in self.ordered())])
        D, *rest = np.split(found, ends[:-1])
        D, points = D.reshape(m, m), dict(zip(self.ordered(), rest, strict=True))
        made = replace(one, D=D, points=points, refined=True)
        for pair in self.once():
            known = self.by.get(pair)
            if known is None or not known.refined or self._is_better(made, pair):
                self.by[pair] = made
        return made

    def _adapted(self, one: Tried) -> Array:
        """D, row by row, and behind it the parameters of each pair's rival, all in one row."""
        task, D, points = self.task, np.zeros_like(one.D), []
        experiment = task.experiments(one.u[None])
        seen = task.measured(experiment)
        for i, true in enumerate(task.candidates):
            y, _ = simulated(true.model, true.theta, experiment)
            for j, rival in enumerate(task.candidates):
                if i != j:
                    theta, _, D[i, j] = adapted(
                        y, rival, self.precisions[j], experiment, seen, one.points[i, j]
                    )
                    points.append(theta)
        return np.concatenate([D.ravel(), *points])

    def ranked(self, found: Sequence[Tried]) -> list[Tried]:
        """The best inputs, rivals adapted; pairs that none of these tells apart no longer count."""
        best: list[Tried] = []
        for _ in range(2):
            order = sorted(found, key=self.worth, reverse=True)[:REFINED]
            best += [
                self.refined(one) for one in order if all(one.plan is not b.plan for b in best)
            ]
            dead = set()
            for pair in self.once():
                most = max(self.worth(one, [pair]) for one in best)
                if most < ALIVE:
                    most = self.worth(self.refined(self.by[pair]), [pair])
                if most < ALIVE:
                    dead.add(pair)
            if dead == self.dead:
                break
            self.dead = dead
        return sorted(best, key=self.worth, reverse=True)

    def starts(self, n: int, progress: Progress) -> list[Tried]:
        """Inputs at random, every family in turn; as often as limits are broken the next are drawn smaller."""
        out: list[Tried] = []
        families = list(FAMILIES)
        nu = self.task.candidates[0].model.nu
        while len(out) < n:
            plans = []
            broken = float(np.mean([one.violation > 0.0 for one in out])) if out else 0.0
            for k in range(BATCH):
                plan = drawn_plan(self.rng, families[(len(out) + k) % len(families)], nu)
                plans.append(self._shrunk(plan) if self.rng.uniform() < broken else plan)
            out += self.evaluate(plans)
            progress(len(out) / n)
        return out

    def _shrunk(self, plan: Plan) -> Plan:
        """The same at a smaller amplitude about a value at random: limits are kept by less."""
        out = []
        for shape in plan:
            middle, share = self.rng.uniform(), float(self.rng.uniform() ** 2)
            v, k = shape.v.copy(), shape.pieces
            if shape.family == "multisine":
                v[:2] = middle, share
            else:
                values = slice(0, 2 if shape.family == "binary" else k)
                v[values] = middle + share * (v[values] - middle)
            out.append(replace(shape, v=v))
        return tuple(out)

    def improved(self, best: Tried, n: int, pairs: Sequence[Pair] | None = None) -> Tried:
        """The best after n more inputs, each another value of one number of the best so far."""
        done = 0
        while done < n:
            self.points = dict(best.points)
            found = self.evaluate([self._moved(best.plan) for _ in range(BATCH)])
            done += len(found)
            leader = max(found, key=lambda one: self.worth(one, pairs))
            if self.worth(leader, pairs) > self.worth(best, pairs):
                leader = self.refined(leader)
                if self.worth(leader, pairs) > self.worth(best, pairs):
                    best = leader
        return best

    def _moved(self, plan: Plan) -> Plan:
        which = int(self.rng.integers(len(plan)))
        shape = plan[which]
        i = int(self.rng.integers(len(shape.v)))
        value = self.rng.uniform()
        if self.rng.uniform() < 0.5:
            value = float(np.clip(shape.v[i] + NEAR * self.rng.standard_normal(), 0.0, 1.0))
        elif self.rng.uniform() < 0.3:
            value = float(np.round(value))
        return (*plan[:which], shape.moved(i, value), *plan[which + 1 :])


def violations(task: Task, runs: Sequence[Runs]) -> tuple[Array, list[str]]:
    """By how much (B,) limits are broken by the worst cause, in shares of their range, and where."""
    B = len(runs[0].y)
    worst, where = np.zeros(B), [""] * B
    limits, sigmas = task.bounds, task.bounds.sigmas
    for candidate, run in zip(task.candidates, runs, strict=True):
        names = [*candidate.model.nonlinear, *candidate.model.linear]
        P = np.asarray(spread(run.J, run.Q, run.P1)) if sigmas else np.zeros((1, 1, *run.P1.shape))
        outputs = list(candidate.model.outputs)
        signals = []
        for name, limit in limits.states.items():
            i = names.index(name)
            signals.append((f"bounds.states.{name}", limit, run.x[..., i], P[..., i, i]))
        for name, limit in limits.outputs.items():
            i = outputs.index(name)
            h = run.H[:, :, i]
            every = np.broadcast_to(P, (*h.shape, h.shape[-1]))
            variance = np.einsum("btx,btxy,bty->bt", h, every, h)
            signals.append((f"bounds.outputs.{name}", limit, run.y[..., i], variance))
        for field_, (low, high), values, variance in signals:
            sd = sigmas * np.sqrt(np.maximum(variance, 0.0))
            over = np.maximum(low - (values - sd), (values + sd) - high).max(axis=1)
            over = over / _width(low, high)
            for b in np.flatnonzero(over > worst):
                worst[b], where[b] = over[b], field_
    return worst, where


def _width(low: float, high: float) -> float:
    """What a limit is measured by: its range; of one side its distance from zero, or 1."""
    if np.isfinite(high - low):
        return high - low
    return max((abs(end) for end in (low, high) if np.isfinite(end)), default=1.0) or 1.0


def search(
    task: Task,
    n: int,
    seed: int,
    progress: Progress,
    known: Sequence[Plan] = (),
    kept: Kept = NOTHING,
) -> Search:
    """Some n inputs, the best first in ``leaders``; ``known`` plans are among them, ``kept`` is done already.

    Raises OptionError where all break a limit.
    """
    state = Search(task, np.random.default_rng(seed), kept)
    first = state.evaluate(known) if known else []
    first += state.starts(BATCH, lambda share: None)
    state.points = state.refined(max(first, key=state.worth)).points
    first += state.starts(int(STARTS * n), lambda share: progress(STARTS * share))
    if all(one.violation > 0.0 for one in first):  # look for one that keeps the limits
        best = state.improved(min(first, key=lambda one: one.violation), n // 2)
        if best.violation > 0.0:
            amount, where = state.nearest
            raise OptionError(
                f"{where or 'bounds'}: none of {state.tried} inputs keeps the limit; the nearest exceeds it "
                f"by {100 * amount:.2g} % of its range (a stop band: of the input's power), "
                f"{task.bounds.sigmas:g} standard deviations of the free run counted (bounds.sigmas). "
                "Widen the limit, or the inputs' range so that it has values that keep it",
                where or "bounds",
            )
        first.append(best)
    first = [one for one in first if one.violation <= 0.0]
    ranked = state.ranked(first)
    each = max((n - state.tried) // (2 * KEPT), BATCH)
    for k, start in enumerate(ranked[:KEPT]):
        state.leaders.append(state.improved(start, each))
        progress(STARTS + (1.0 - STARTS) * 0.5 * (k + 1) / KEPT)
    state.leaders.sort(key=state.worth, reverse=True)
    while state.tried < n:
        state.leaders[0] = state.improved(state.leaders[0], BATCH)
        progress(min(state.tried / n, 1.0))
    return state
