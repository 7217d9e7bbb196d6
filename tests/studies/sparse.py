"""Sparse regression on smoothed states, by PySINDy: which nonlinear terms does an equation need?

The equation of one state is regressed on a library: constant, all states and all inputs, and for each
state its square, cube, x|x| and sign. PySINDy's STLSQ (ridge regression, terms with coefficients below
a threshold left out, repeated) is run over a grid of thresholds on normalised columns; coefficients are
in units of the norm of what is explained. A rule then picks the threshold.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.statespace.model import Array
from tests.studies.study import StudyError

KINDS: dict[str, Callable[[Array], Array]] = {  # named as in the catalogue of effects
    "quadratic": lambda x: x**2,
    "cubic": lambda x: x**3,
    "drag": lambda x: x * np.abs(x),
    "coulomb": np.sign,
}
THRESHOLDS = np.geomspace(1e-4, 1.0, 33)
FITTED = 0.75  # of the rows, where the last ones are held out to choose a threshold
ITERATIONS = 50


@dataclass(frozen=True)
class Way:
    """How the regression is set up.

    ``target`` is the next value (``step``) or the central difference (``derivative``) of the state;
    the model's own ``linear`` terms are always ``kept``, or ``thresholded`` like the others;
    ``ridge`` is the penalty of STLSQ.
    """

    target: str
    linear: str
    ridge: float


@dataclass(frozen=True)
class Setting:
    """A way, and the rule by which a threshold is picked.

    ``threshold``: always the one next to ``value``; ``bic``: least n log(rss) + value k log(n), as the
    errors of smoothed states are not independent; ``held-out``: the largest threshold whose squared
    error on held-out rows is within ``value`` of the least.
    """

    way: Way
    rule: str
    value: float

    def __str__(self) -> str:
        way = self.way
        return f"{way.target}, linear terms {way.linear}, ridge {way.ridge:g}, {self.rule} {self.value:.3g}"


WAYS = tuple(
    Way(*way)
    for way in itertools.product(("step", "derivative"), ("kept", "thresholded"), (1e-6, 0.05))
)
RULES = (
    *(("threshold", float(value)) for value in THRESHOLDS),
    *(("bic", value) for value in (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)),
    *(("held-out", value) for value in (0.0, 0.003, 0.01, 0.03)),
)
SETTINGS = tuple(Setting(way, *rule) for way in WAYS for rule in RULES)


@dataclass(frozen=True, eq=False)
class Equation:
    """``y`` (n,) to be explained by ``linear`` (n, L) and nonlinear ``terms`` (n, K) of given names."""

    y: Array
    linear: Array
    terms: Array
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Path:
    """For each threshold: nonlinear terms ``kept`` (n, K), all terms' ``number``, ``rss``, ``held_out``.

    ``rss`` is the sum of squared errors of the ``rows`` rows, ``held_out`` the mean square of others.
    """

    names: tuple[str, ...]
    kept: NDArray[np.bool_]
    number: NDArray[np.intp]
    rss: Array
    rows: int
    held_out: Array

    def answer(self, setting: Setting) -> frozenset[str]:
        """The terms that remain at the threshold picked by the setting's rule."""
        return self.terms(self._index(setting.rule, setting.value))

    def terms(self, i: int) -> frozenset[str]:
        """The nonlinear terms at threshold ``i``."""
        return frozenset(
            name for name, is_in in zip(self.names, self.kept[i], strict=True) if is_in
        )

    def _index(self, rule: str, value: float) -> int:
        if rule == "threshold":
            return int(np.argmin(np.abs(THRESHOLDS - value)))
        if rule == "bic":
            penalty = value * self.number * np.log(self.rows)
            return int(np.argmin(self.rows * np.log(self.rss) + penalty))
        close = self.held_out <= (1.0 + value) * self.held_out.min()
        return int(np.flatnonzero(close)[-1])


def equation(
    x: Array, u: Array, dt: float, states: Sequence[str], state: str, target: str
) -> Equation:
    """The equation of ``state`` from states x (T, nx) and inputs u (T, nu) at intervals of ``dt``."""
    v = x[:, list(states).index(state)]
    if target == "step":
        y, x, u = v[1:], x[:-1], u[:-1]
    else:
        y = np.gradient(v, dt)
    linear = np.column_stack([np.ones(len(x)), x, u])
    terms = np.column_stack(
        [function(x[:, [i]]) for i in range(len(states)) for function in KINDS.values()]
    )
    names = [
        f"{kind}:{source}" if source == state else f"{kind}:{source}->{state}"
        for source in states
        for kind in KINDS
    ]
    return Equation(y, linear, terms, tuple(names))


def path(equation: Equation, way: Way) -> Path:
    """Sparse regressions of an equation at all thresholds. Raises StudyError without PySINDy."""
    n, K = equation.terms.shape
    D, y = _design(equation, way.linear, n)
    coefficients = _sweep(D, y, way.ridge)
    first = int(FITTED * n)
    D1, y1 = _design(equation, way.linear, first)
    ahead = y1[first:] - _sweep(D1[:first], y1[:first], way.ridge) @ D1[first:].T
    return Path(
        equation.names,
        coefficients[:, :K] != 0.0,
        np.count_nonzero(coefficients, axis=1),
        ((y - coefficients @ D.T) ** 2).sum(axis=1),
        n,
        (ahead**2).mean(axis=1),
    )


def _design(equation: Equation, linear: str, rows: int) -> tuple[Array, Array]:
    """Columns, the nonlinear terms first, and what they explain.

    Where linear terms are kept, what they explain, judged by the first ``rows`` rows, is taken out
    of both: the regression of the rest is the one in which they have no threshold and no penalty.
    """
    if linear == "thresholded":
        return np.column_stack([equation.terms, equation.linear]), equation.y
    both = np.column_stack([equation.terms, equation.y])
    slopes = np.linalg.lstsq(equation.linear[:rows], both[:rows], rcond=None)[0]
    rest = both - equation.linear @ slopes
    return rest[:, :-1], rest[:, -1]


def _sweep(D: Array, y: Array, ridge: float) -> Array:
    """Coefficients (thresholds, p) of y (n,) on the columns of D (n, p)."""
    stlsq = _stlsq()
    norm = float(np.linalg.norm(y))
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a threshold leaves nothing is an answer here
        for threshold in THRESHOLDS:
            fit = stlsq(
                threshold=threshold, alpha=ridge, max_iter=ITERATIONS, normalize_columns=True
            )
            found.append(norm * np.asarray(fit.fit(D, y / norm).coef_[0]))
    return np.array(found)


def _stlsq() -> Any:
    try:
        from pysindy import STLSQ
    except ImportError as error:
        raise StudyError("this study needs PySINDy: pip install 'rbps[dev]'") from error
    return STLSQ
