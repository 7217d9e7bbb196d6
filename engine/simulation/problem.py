"""The least-squares problem of free runs: residuals and derivatives over parameters and first states.

p = (free parameters that change the run, first states of each series). A run and all its derivatives are
found at once where that converges, see :mod:`engine.simulation.whole_record` and
:mod:`engine.simulation.sensitivities`; else the run by a loop over time. Where derivatives along the run
are not those of differences of runs (a model that jumps), these are taken, in one pass over time where the
model's functions take arrays of parameters, as plain NumPy ones do.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from engine.data.series import Series
from engine.errors import ModelError
from engine.failing import where_it_fails
from engine.simulation.covariance import Determined, run_covariance
from engine.simulation.free_run import (
    first_state,
    following,
    free_run,
    output_scale,
    run_rows,
    spread_of,
)
from engine.simulation.sensitivities import Along
from engine.simulation.simulate import states_of
from engine.simulation.steps import observations, tested
from engine.simulation.whole_record import SHORTEST
from engine.statespace.model import Array, MixedModel, Theta

STEP = 1e-5  # finite-difference step as a share of a parameter's scale
WIDER = 4.0  # times that: derivatives that differ there by much are noise of the model, as of adaptive steps
REFINED = 4  # random starts that are followed
TRIALS = 8  # sizes tried for a parameter of unknown scale
PRECISE = 1e-7  # relative change of the cost or of p at which the search ends
SILENT = 1e-9  # a derivative below this share of the largest one is no influence
AWAY = 1e6  # times the largest reading: a run so far off is lost, and squares of it overflow
TOO_STEEP = 1e40  # derivatives from there on are none; their sixth power would overflow in a step
LOOKED_AT = 1000  # rows, of all records together, on which derivatives of both kinds are compared
BENT = 0.3  # of sqrt(precise): so much of the residuals may bend where derivatives are kept
ALIKE = 0.01  # share by which a column of derivatives may differ from differences of runs ...
WEAK = 1e-6  # ... of the largest column: what differences of runs resolve

Run: TypeAlias = tuple[Array, Array]  # x (T, nx), y (T, ny)


class FreeRunProblem:
    """Residuals and their derivatives as a function of p = (active parameters, first states)."""

    def __init__(
        self,
        model: MixedModel,
        series: list[Series],
        theta: Theta,
        free: NDArray[np.intp],
        x1: Array | None = None,
        runs: Sequence[Array | None] | None = None,
    ) -> None:
        """Of some parameters; ``x1`` (S, nx) first states to begin with, else those of the model.

        ``runs`` are runs (T, nx) near those from there, for each series, as guesses.
        """
        self.model, self.series, self.theta = model, series, theta
        self.active, self.silent = free, free[:0]
        self.scale = output_scale(series)
        given = [max(abs(p.default), p.scale) for p in model.parameters]
        self.sizes: Array = np.maximum(np.abs(np.asarray(theta)), given)
        self.mean, self.spread = first_state(model, theta)
        self.x1 = np.tile(self.mean, (len(series), 1)) if x1 is None else x1
        self.uncertain = np.flatnonzero(self.spread > 0.0)
        self.known = self.spread == 0.0
        z1 = model.start(model.record(theta)).z1
        # z_1 that is known given a_1, which is found: runs begin elsewhere with each
        self.follows = callable(z1) and bool(self.known[model.na :].any())
        self.evaluations = 0
        self.step = STEP
        self.at_once = not self.follows  # derivatives along the run, not by differences of runs
        self.as_whole = [False] * len(series)  # whether those of the last evaluation were
        self.runs = list(runs or [None] * len(series))  # the last of each, to begin with
        self._last: tuple[bytes, Array, Array] | None = None  # p, residuals, derivatives
        # p, residuals and runs, where derivatives were not asked for
        self._ahead: tuple[bytes, Array, list[Run]] | None = None

    def names(self, indices: NDArray[np.intp]) -> tuple[str, ...]:
        """Names of parameters."""
        return tuple(self.model.parameter_names[i] for i in indices)

    def start(self) -> Array:
        """The vector p at theta0 and the first states to begin with."""
        first_states = self.x1[:, self.uncertain].ravel()
        return np.concatenate((np.asarray(self.theta)[self.active], first_states))

    def split(self, p: Array) -> tuple[Theta, Array]:
        """Theta and the first states (S, nx)."""
        theta = np.array(self.theta)
        theta[self.active] = p[: self.active.size]
        x1 = self.x1 + self._moved(theta)
        x1[:, self.uncertain] = p[self.active.size :].reshape(len(self.series), -1)
        return self.model.theta(theta), self._following(theta, x1)

    def _following(self, theta: Array, x1: Array) -> Array:
        """First states (K, nx) with the linear ones that are known given the nonlinear ones."""
        return (
            following(self.model, self.model.theta(theta), x1, self.known) if self.follows else x1
        )

    def _moved(self, theta: Array) -> Array:
        """How far theta (n_theta,) moves first states that are known, and so not found themselves (nx,)."""
        if (self.spread > 0.0).all():
            return np.zeros(len(self.spread))
        lost = np.full_like(self.mean, np.nan), self.spread
        mean, _ = where_it_fails(lost)(first_state)(self.model, self.model.theta(theta))
        return np.where(self.spread > 0.0, 0.0, mean - self.mean)

    def bounds(self) -> tuple[Array, Array]:
        """Bounds of p."""
        n = len(self.series) * self.uncertain.size
        low, high = self.model.lower[self.active], self.model.upper[self.active]
        return (
            np.concatenate((low, np.full(n, -np.inf))),
            np.concatenate((high, np.full(n, np.inf))),
        )

    def look_for_silent(self) -> None:
        """Take parameters out that do not change the run around the start."""
        self._look_for_sizes()
        self._last = None  # its derivatives were taken over other distances
        e, jacobian = self.evaluate(self.start())
        if not self._agree(jacobian):
            self.at_once, self._last = False, None
            e, jacobian = self.evaluate(self.start())
        # beside derivatives of a run that runs away all others seem to be none
        near = np.abs(e) < AWAY * self.reach()
        quiet = ~self.shows(jacobian[near] if near.any() else jacobian)
        self.silent, self.active = self.active[quiet], self.active[~quiet]
        self._last = self._ahead = None

    def shows(self, J: Array) -> NDArray[np.bool_]:
        """Which of the active parameters change the run, by the derivatives (n, n_p) of its residuals."""
        size = np.abs(J[:, : self.active.size]).max(axis=0, initial=0.0) * self.steps()
        return np.asarray(size > SILENT * float(size.max(initial=0.0)))

    def _look_for_sizes(self) -> None:
        """A size for each active parameter that starts at 0: what changes the run as much as it is wrong."""
        for i, k in enumerate(self.active):
            if self.sizes[k] > 0.0:
                continue
            self.sizes[k] = 1.0
            for _ in range(
                TRIALS
            ):  # differences over a wrong size are lost in rounding, or too long
                self._last = None
                residuals, jacobian = self.evaluate(self.start())
                wrong, slope = (float(np.sqrt(np.mean(x**2))) for x in (residuals, jacobian[:, i]))
                if not np.isfinite(slope):
                    self.sizes[k] *= 1e-3
                    continue
                found = wrong / slope if slope * wrong > 0.0 else 1e6 * self.sizes[k]
                if 0.1 < found / self.sizes[k] < 10.0 or not np.isfinite(found):
                    break
                self.sizes[k] = found

    def steps(self) -> Array:
        """Finite-difference steps of the active parameters."""
        return np.asarray(self.step * self.sizes[self.active])

    def descend(
        self,
        start: Array,
        evaluations: int,
        rows: NDArray[np.bool_] | None = None,
        precise: float = PRECISE,
    ) -> OptimizeResult:
        """Least squares from p = start; over those of the residuals (n,) that are marked, if any are.

        Derivatives are kept from step to step while residuals change as they foretell: what bends less
        than a part of sqrt(precise) of the residuals moves the cost by a share of ``precise``.
        """
        kept = slice(None) if rows is None else rows
        low, high = self.bounds()

        most = AWAY * self.reach()
        there: list[tuple[Array, Array, Array]] = []  # where derivatives were taken last

        def residuals(p: Array) -> Array:
            e = self.residuals(p)[kept]
            return e if np.abs(e).max(initial=0.0) < most else np.full_like(e, np.inf)

        def jacobian(p: Array) -> Array:
            e = self.residuals(p)[kept]
            if there:
                p0, e0, J0 = there[0]
                bent = np.linalg.norm(e - e0 - J0 @ (p - p0))
                if bent <= BENT * np.sqrt(precise) * np.linalg.norm(e):
                    return J0
            there[:] = [(p.copy(), e, self.evaluate(p)[1][kept])]
            return there[0][2]

        start = np.clip(start, low, high)
        if not np.isfinite(residuals(start)).all():
            raise ModelError(f"model '{self.model.name}': the run from these values runs away")
        # In units of the typical sizes: a start closer than 1e-10 to a bound, in any unit, is moved off it.
        # First states by how far they move, for a step is small beside them where they are far from zero.
        size, origin = self.scales(), start.copy()
        origin[: self.active.size] = 0.0
        unit = self.unit

        def scaled(x: Array) -> Array:
            return residuals(origin + size * x) / unit

        def slopes(x: Array) -> Array:
            return jacobian(origin + size * x) * size / unit

        found = least_squares(
            scaled,
            (start - origin) / size,
            slopes,
            bounds=((low - origin) / size, (high - origin) / size),
            ftol=precise,
            xtol=precise,
            max_nfev=evaluations,
        )
        found.x = np.clip(origin + size * found.x, low, high)
        found.cost *= unit**2
        return found

    @property
    def unit(self) -> float:
        """The spread of readings in which residuals are counted, as one output is not weighed."""
        return float(spread_of(self.series)[0]) if len(self.scale) == 1 else 1.0

    def scales(self) -> Array:
        """Typical size of each component of p: of the parameters, and of the first states."""
        return np.concatenate(
            (self.sizes[self.active], np.tile(self.spread[self.uncertain], len(self.series)))
        )

    def starts(self, n: int, rng: np.random.Generator) -> list[Array]:
        """theta0, and the best of n random vectors around it, as far as their runs do not run away."""
        first, k = self.start(), self.active.size
        draws = np.tile(first, (n + 1, 1))
        typical = self.sizes[self.active]
        factor = np.exp(0.7 * rng.standard_normal((n, k)))
        shift = 0.1 * typical * rng.standard_normal((n, k)) * (first[:k] == 0.0)
        low, high = self.bounds()
        draws[1:, :k] = np.clip(first[:k] * factor + shift, low[:k], high[:k])
        costs = self._costs(draws)
        best = [i for i in np.argsort(costs) if i > 0 and np.isfinite(costs[i])][:REFINED]
        return [draws[i] for i in ([0] if np.isfinite(costs[0]) else []) + best]

    def _costs(self, draws: Array) -> Array:
        """Sum of squares of each p (K, n_p), inf where the run runs away."""
        total, most = np.zeros(len(draws)), AWAY * self.reach()
        pairs = [self.split(p) for p in draws]
        thetas = np.array([theta for theta, _ in pairs])
        for s, one in enumerate(self.series):
            y, _ = run_rows(self.model, thetas, one, np.array([x1[s] for _, x1 in pairs]))
            e = ((one.y[:, None] - y) / self.scale).transpose(0, 2, 1)[one.observed]
            with np.errstate(over="ignore"):
                total += np.where(np.abs(e).max(axis=0) < most, (e**2).sum(axis=0), np.inf)
        return np.where(np.isfinite(total), total, np.inf)

    def runs_away(self) -> None:
        """Raise ModelError that says where the run from the start is lost."""
        theta, x1 = self.split(self.start())
        for one, x in zip(self.series, x1, strict=True):
            free_run(self.model, theta, one, x[: self.model.na], x[self.model.na :])
        raise ModelError(f"model '{self.model.name}': the run from theta0 is too large to fit")

    def reach(self) -> float:
        """The largest reading, weighed as the residuals; 1 where all are zero."""
        values = [np.abs(one.y / self.scale)[one.observed] for one in self.series]
        return max((float(y.max(initial=0.0)) for y in values), default=0.0) or 1.0

    def residuals(self, p: Array) -> Array:
        """Residuals (n,) alone, where their derivatives are not had for the same price."""
        key = p.tobytes()
        for known in (self._last, self._ahead):
            if known is not None and known[0] == key:
                return known[1]
        if not all(self.as_whole):
            return self.evaluate(p)[0]
        theta, x1 = self.split(p)
        found: list[Run] = []
        for s in range(len(self.series)):
            run = self._at_once(theta, x1[s], s)
            if run is None:
                return self.evaluate(p)[0]
            found.append(run)
        self.evaluations += 1
        parts = zip(self.series, found, strict=True)
        e = np.concatenate([((one.y - y) / self.scale)[one.observed] for one, (_, y) in parts])
        self._ahead = (key, e, found)
        return e

    def begin_at(self, p: Array, e: Array, J: Array) -> None:
        """Residuals and derivatives at p, evaluated before."""
        self._last = (p.tobytes(), e, J)

    def evaluate(self, p: Array) -> tuple[Array, Array]:
        """Residuals (n,) and their derivatives (n, n_p); 0 where these are not finite or as good as."""
        key = p.tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1], self._last[2]
        ahead = self._ahead[2] if self._ahead is not None and self._ahead[0] == key else None
        self.evaluations += ahead is None
        theta, x1 = self.split(p)
        k, m, S = self.active.size, self.uncertain.size, len(self.series)
        blocks, derivatives = [], []
        for s, one in enumerate(self.series):
            run = self._at_once(theta, x1[s], s) if ahead is None else ahead[s]
            self.as_whole[s] = run is not None
            if run is not None and not np.isfinite(run[0]).all():  # lost: no derivatives lead back
                y, dy = run[1], np.zeros((*one.y.shape, k + m))
            elif run is None:
                y, dy = self._by_differences(theta, x1[s], one)
            else:
                y, dy = run[1], self._slopes(theta, run[0], one)
            slope = (-dy / self.scale[:, None])[one.observed]
            block = np.zeros((len(slope), k + S * m))
            block[:, :k] = slope[:, :k]
            block[:, k + s * m : k + (s + 1) * m] = slope[:, k:]
            blocks.append(((one.y - y) / self.scale)[one.observed])
            derivatives.append(np.where(np.abs(block) < TOO_STEEP, block, 0.0))
        out = np.concatenate(blocks), np.concatenate(derivatives)
        self._last = (key, *out)
        return out

    def _at_once(self, theta: Theta, x1: Array, s: int) -> Run | None:
        """The run of a series, None where derivatives along it are not those of differences, or not cheaper."""
        model, one = self.model, self.series[s]
        if not self.at_once or len(one) < SHORTEST:
            return None
        lost = np.full_like(one.y, np.inf)
        nowhere: Run | None = np.full((len(one), model.nx), np.nan), lost

        @where_it_fails(nowhere)
        def run() -> Run | None:
            record = model.record(theta)
            model.observations.look_again()
            x = states_of(model, record, one, x1, self.runs[s])
            if not np.isfinite(x).all():
                return x, lost
            self.runs[s] = x
            with np.errstate(all="ignore"):
                seen = tested(model, observations(model, record, one), x)
            return None if seen is None else (x, seen.value)

        return run()

    def _slopes(self, theta: Theta, x: Array, one: Series) -> Array:
        """Derivatives (T, ny, k + m) of a series' outputs along its run x (T, nx)."""
        along = Along(self.model, np.asarray(theta), one, x)
        beginning = self._beginnings(self._around(theta))
        return along.by(self.active, self.uncertain, self.steps(), beginning)[0]

    def _around(self, theta: Theta) -> Array:
        """Theta, and each active parameter a step up and down within its bounds (1 + 2 k, n_theta)."""
        thetas = np.tile(np.asarray(theta), (2 * self.active.size + 1, 1))
        for i, (column, h) in enumerate(zip(self.active, self.steps(), strict=True)):
            thetas[1 + 2 * i, column] = min(theta[column] + h, self.model.upper[column])
            thetas[2 + 2 * i, column] = max(theta[column] - h, self.model.lower[column])
        return thetas

    def _reach(self, thetas: Array) -> Array:
        """From the step down to the step up of each active parameter (k,)."""
        return np.asarray((thetas[1::2] - thetas[2::2])[np.arange(self.active.size), self.active])

    def _beginnings(self, thetas: Array) -> Array:
        """Derivatives of the first states (nx, k) by the active parameters, from ``_around``."""
        if not self.active.size or (self.spread > 0.0).all():
            return np.zeros((len(self.spread), self.active.size))
        moved = np.array([self._moved(theta) for theta in thetas[1:]])
        with np.errstate(all="ignore"):
            return np.asarray((moved[::2] - moved[1::2]).T / self._reach(thetas))

    def _by_differences(self, theta: Theta, x1: Array, one: Series) -> tuple[Array, Array]:
        """The same by central differences of runs; one-sided at a bound, NaN where one is not finite."""
        k, m = self.active.size, self.uncertain.size
        h = self.step * self.spread[self.uncertain]
        around = self._around(theta)
        thetas = np.concatenate((around, np.tile(around[0], (2 * m, 1))))
        x = np.tile(x1, (len(thetas), 1))
        moved = np.array([self._moved(other) for other in around])
        x[: 1 + 2 * k] += moved - moved[0]
        for i, column in enumerate(self.uncertain):
            x[1 + 2 * (k + i), column] += h[i]
            x[2 + 2 * (k + i), column] -= h[i]
        if self.follows:
            x = np.concatenate([self._following(t, x[i : i + 1]) for i, t in enumerate(thetas)])
        y, _ = run_rows(self.model, thetas, one, x)
        reach = np.concatenate((self._reach(around), 2.0 * h))
        with np.errstate(all="ignore"):
            dy = np.swapaxes(y[:, 1::2] - y[:, 2::2], 1, 2) / reach
        return y[:, 0], dy

    def _agree(self, jacobian: Array) -> bool:
        """Whether derivatives found at once (n, n_p) are, at the start, those of differences of runs.

        They are not where the model jumps, and where friction sticks and slips too often. Looked at are the
        first rows of each record, which share ``LOOKED_AT``.
        """
        theta, x1 = self.split(self.start())
        h = np.concatenate((self.steps(), self.step * self.spread[self.uncertain]))
        k, m, begin, every = self.active.size, self.uncertain.size, 0, sum(map(len, self.series))
        for s, one in enumerate(self.series):
            own = jacobian[begin : begin + int(one.observed.sum())]
            begin += len(own)
            if not self.as_whole[s]:
                continue
            part = one.part(0, min(len(one), -(-LOOKED_AT * len(one) // every)))
            dy = self._by_differences(theta, x1[s], part)[1]
            other = (-dy * h / self.scale[:, None])[part.observed]
            columns = [*range(k), *range(k + s * m, k + (s + 1) * m)]
            own = own[: len(other), columns] * h
            with np.errstate(over="ignore"):
                size = np.linalg.norm(other, axis=0)
                off = np.linalg.norm(own - other, axis=0)
            known = np.isfinite(size)
            allowed = ALIKE * size + WEAK * size[known].max(initial=0.0)
            if not (off <= allowed)[known].all():
                return False
        return True

    def uncertainty(self, e: Array, J: Array, p: Array | None = None) -> Determined:
        """Covariance of p from residuals (n,) and their derivatives (n, n_p) there.

        Given p, derivatives in weak directions are held against those over wider steps.
        """
        wider = None if p is None else lambda: self._over_wider_steps(p)
        places = [np.nonzero(one.observed) for one in self.series]
        record = np.repeat(np.arange(len(places)), [len(rows) for rows, _ in places])
        row, channel = (np.concatenate(own) for own in zip(*places, strict=True))
        return run_covariance(e, J, record, row, channel, wider)

    def _over_wider_steps(self, p: Array) -> Array:
        """Derivatives (n, n_p) of the residuals at p by differences over WIDER times the steps."""
        last, evaluations = self._last, self.evaluations
        self.step, self._last = WIDER * STEP, None
        try:
            return self.evaluate(p)[1]
        finally:
            self.step, self._last, self.evaluations = STEP, last, evaluations
