"""Records in closed loop, where the input was computed from the readings.

A controller that sees y_t before it sets u_t makes u_t depend on the error e_t of that reading. The model's
own steps are right all the same, for u_t acts after y_t. But an effect that compares a reading with the input
of its own row, such as a direct path, sees the controller and takes it for a cause. The record does not tell
the two apart. It does tell that there is a controller: past errors of prediction, with the direct path in the
model, then foretell the input (Granger 1969; Gustavsson, Ljung, Soderstrom 1977), which they do not where it is
given from outside. A thermostat shows little of this: it is the error of its own row that decides when it
switches. But it switches where a reading, with its error, crosses a level. With other errors it would not.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.distributions import normal_sf
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, whitening
from engine.filters.sigma_point import moment_path
from engine.statespace.model import Array

OWN = 8  # past inputs that say what an input will be
RANGES, IN_RANGE = 6, 40  # of an input, at most, and rows in each, at least
CLOCK = 3  # powers of time by which what an input says of errors changes
FADING = (0.0, 0.5, 0.9)  # from row to row, of errors that are summed
LEVEL = 0.01  # of all inputs together: a name that is none is worse than one left out
SHUFFLED = 999  # times errors of prediction are shuffled: is an input still switched at a level?
FAR = 3.0  # medians, beyond which a change of an input is cut
ROUNDING = 1e-13  # of a reading: what is more is an effect, however small its unit makes it


def answering(fit: QuasiFit, series: Series) -> list[str]:
    """Names of inputs that answer the readings, as the model's errors of prediction tell."""
    model = fit.model
    rows = series.samples  # the input is held between them
    if not model.inputs or len(rows) < 5 * OWN:
        return []
    path = moment_path(model, np.asarray(fit.theta), series)
    root = whitening(path.S, series.observed)
    errors = np.einsum("tij,tj->ti", root, np.nan_to_num(path.innovations))
    sd = np.sqrt(np.diagonal(path.S, axis1=1, axis2=2))[rows]
    expected = (series.y - path.innovations)[rows]
    level = LEVEL / len(model.inputs)
    return [
        name
        for name, u in zip(model.inputs, series.u[rows].T, strict=True)
        if foretold(u, errors[rows]) < level or switched(u, series.y[rows], expected, sd) < level
    ]


def of_own_row(effect: Effect, setting: Setting, inputs: Sequence[str]) -> bool:
    """Whether an effect makes a reading depend on one of the ``inputs`` of its own row, or of a later one."""
    if effect.traits.says_hold:
        return effect.channel in inputs
    base, model = setting.model, effect.apply(setting.model)
    points, known = setting.points(base)
    low, high = effect.size.bounds
    size = min(max(1.0, low), high)
    others = [p.default for p in effect.parameters[1:]]
    if len(effect.probes[0]) == len(others):
        others = list(effect.probes[0])
    theta = np.concatenate([known, [size], others])
    records = base.record(known), model.record(theta)

    def read(u: Array, x: Array, t: float) -> list[tuple[Array, Array]]:
        """h and R, each without and with the effect."""
        found = []
        for one, record in zip((base, model), records, strict=True):
            a = np.zeros((1, one.na))
            a[0, : base.na] = x[: base.na]
            h, _, R = one.observation(a, u, t, record)
            found.append((h[0], R if R.ndim == 2 else R[0]))
        return list(zip(*found, strict=True))

    with np.errstate(all="ignore"), suppress(EngineError):  # of a size that may be any
        for j in (list(model.inputs).index(name) for name in inputs):
            for x, u, t in zip(points.x, points.u, points.t.tolist(), strict=True):
                moved = u.copy()
                moved[j] += setting.size(list(base.inputs)[j])
                if any(map(_adds, read(u, x, t), read(moved, x, t))):
                    return True
    return False


def _adds(here: tuple[Array, Array], there: tuple[Array, Array]) -> bool:
    """Whether an effect adds something else to a moment of the reading, (without, with it), there than here."""
    added, then = here[1] - here[0], there[1] - there[0]
    size = ROUNDING * max(float(np.abs(part).max()) for part in (*here, *there))
    return not np.allclose(added, then, ROUNDING, size, equal_nan=True)


def foretold(u: Array, errors: Array) -> float:
    """p-value of ``errors`` (T, ny), fading sums of those of earlier rows, telling nothing of ``u`` (T,).

    Where the input is given, whatever it is, errors are independent of all of it: so they are of its changes
    and of what its own past does not say of it, which a controller moves. What this and earlier inputs say of
    the errors themselves is a model that is not quite right, at some of the inputs or for some of the time, and
    left out: an input that is given changes from where it was, and errors that still hold a part of it would
    foretell that change. Robust to errors whose size differs from row to row (White 1980).
    """
    T, rows = len(u), np.arange(OWN, len(u))
    clock = np.linspace(-1.0, 1.0, T)[rows, None] ** np.arange(CLOCK + 1)
    lags = [u[rows - k] for k in range(1, OWN + 1)]
    news, change = np.zeros(T), np.diff(u, prepend=u[0])
    news[rows] = _left(u[rows], clock[:, :2], *lags)
    errors = errors.copy()
    errors[:OWN] = 0.0
    errors[rows] = _left(errors[rows], clock, *lags, _bent(u[rows]), clock * u[rows, None])
    least, p = 1e-9 * float(np.ptp(u)), 1.0
    # else its past says it all
    moved = [part for part in (news, change, *map(_within, (news, change))) if np.ptp(part) > least]
    for part in moved:
        for fading in FADING:
            products = errors * _after(part, fading)[:, None]
            power = np.sqrt((products**2).sum(axis=0))
            z = np.abs(products.sum(axis=0)) / np.where(power > 0.0, power, 1.0)
            p = min(p, float(2.0 * normal_sf(z.max())))
    return float(min(1.0, p * len(moved) * len(FADING) * errors.shape[1]))


def switched(u: Array, y: Array, expected: Array, sd: Array) -> float:
    """p-value of an input (T,) of two levels being switched as it is whatever the errors of y (T, ny).

    Errors about what was ``expected`` (T, ny), by their ``sd`` (T, ny), are shuffled. What counts is how many
    rows are on the wrong side of the levels at which the input is switched on and off.
    """
    levels = np.unique(u)
    if len(levels) != 2:
        return 1.0
    on, least, rng = u == levels[1], 1 + SHUFFLED, np.random.default_rng(0)
    for k in range(y.shape[1]):
        seen = np.flatnonzero(np.isfinite(y[1:, k])) + 1
        before, turns = on[seen - 1], on[seen] != on[seen - 1]
        found = _wrong_side(y[seen, k], before, turns)
        mean, spread = expected[seen, k], sd[seen, k]
        errors = (y[seen, k] - mean) / spread
        draws = (mean + spread * rng.permutation(errors) for _ in range(SHUFFLED))
        as_good = [_wrong_side(one, before, turns) <= found for one in draws]
        least = min(least, 1 + sum(as_good))
    return float(min(1.0, least * y.shape[1] / (1 + SHUFFLED)))


def _wrong_side(values: Array, before: NDArray[np.bool_], turns: NDArray[np.bool_]) -> int:
    """How many of ``values`` (n,) are on the wrong side of the levels that best part those that turn.

    Of those that were on ``before`` it is one level, of the others another.
    """
    wrong = 0
    for side in (before, np.logical_not(before)):
        turned = turns[side][np.argsort(values[side])]
        steps = np.where(turned, 1, -1)
        below = np.cumsum(np.concatenate([[np.count_nonzero(~turned)], steps]))
        wrong += int(min(below.min(), len(turned) - below.max()))
    return wrong


def _left(y: Array, *known: Array) -> Array:
    """What is left of y (n,) or (n, k) beside what is known (n,) or (n, .), in any units, by least squares."""
    X = np.column_stack(known)
    size = np.linalg.norm(X, axis=0)
    X = X / np.where(size > 0.0, size, 1.0)
    return np.asarray(y - X @ np.linalg.lstsq(X, y, rcond=None)[0])


def _bent(u: Array) -> Array:
    """Lines in ranges of an input (n,) with as many rows in each: any function of it, nearly."""
    count = int(np.clip(len(u) // IN_RANGE, 1, RANGES))
    ends = np.unique(np.quantile(u, np.arange(1, count) / count))
    inside = np.eye(len(ends) + 1)[np.searchsorted(ends, u, side="right")]
    return np.hstack([inside, inside * (u - u.mean())[:, None]])


def _within(part: Array) -> Array:
    """A part of an input (T,) with what is far from its usual size cut: a set point steps, and hides errors."""
    moving = np.abs(part[part != 0.0])
    most = FAR * float(np.median(moving)) if moving.size else 0.0
    return np.clip(part, -most, most)


def _after(part: Array, fading: float) -> Array:
    """Of each row the sum of ``part`` (T,) over those after it, fading from row to row."""
    out, total = np.zeros(len(part)), 0.0
    for t in range(len(part) - 2, -1, -1):
        total = fading * total + part[t + 1]
        out[t] = total
    return out


def told(names: Sequence[str], inputs: Sequence[str]) -> str:
    """A sentence on effects that were set aside."""
    return (
        "The record seems to be one in closed loop: errors of prediction of the readings say something of "
        f"{', '.join(inputs)}. "
        "What compares a reading with the input of its own row cannot be told from a controller that saw this "
        f"reading, and was left out: {', '.join(names)}. To look for it, record with an input that is given "
        "from outside."
    )
