"""What every model has: a name, named inputs and outputs, and parameters theta with bounds."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Self, TypeAlias
from weakref import WeakSet

import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine.arrays import Array as Array
from engine.errors import OptionError
from engine.statespace.evaluation import ModelFunction
from engine.statespace.trial import Regular
from engine.ties import Ties
from engine.views import Shown, View, sheet, tables
from engine.words import held_by_bounds, tidy

ThetaLike: TypeAlias = "Mapping[str, float] | ArrayLike | None"
NONE = Ties()


@dataclass(frozen=True)
class Parameter:
    """One component of theta.

    Parameters
    ----------
    name : str
        A Python identifier: the model's functions have the value as ``theta.NAME``.
    default : float
        The value where none is given, from which estimations start.
    unit : str
        A label such as ``N s/m``; "" or "1" for a pure number. No value is converted.
    bounds : tuple of float
        The closed interval [low, high] in which the value lies, in the same unit; infinite by default.
    description : str
        What it means, in a few words.
    scale : float
        A typical size, in the same unit; only a parameter whose default is 0 may need one, and estimations
        find it from the data where it is 0.
    """

    name: str
    default: float
    unit: str = ""
    bounds: tuple[float, float] = (-np.inf, np.inf)
    description: str = ""
    scale: float = 0.0


NEXT_TO_NOTHING = 1e-3  # of a parameter's start: a lower bound above 0 that is as good as 0
AT_BOUND = 1e-6  # of a parameter's size: searches that stay inside a bound come as near


class Theta(np.ndarray[tuple[int], np.dtype[np.float64]]):
    """Parameter values as a vector (n_theta,) with names: ``theta[0]``, ``theta["k1"]``.

    Parameters
    ----------
    values : array (n_theta,)
        One number for each parameter, in its unit; they are copied.
    names : sequence of str
        The parameters' names, in the same order.
    """

    names: tuple[str, ...]

    def __new__(cls, values: ArrayLike, names: Sequence[str]) -> Self:
        """A copy of ``values`` that knows the ``names`` of its components."""
        self = np.array(values, dtype=float).view(cls)
        self.names = tuple(names)
        return self

    def __array_finalize__(self, obj: Any) -> None:
        self.names = getattr(obj, "names", ())

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str):
            return float(np.asarray(self)[self.names.index(key)])
        value = np.asarray(self)[key]
        return value if isinstance(value, np.ndarray) else float(value)

    def __reduce__(self) -> tuple[Any, ...]:  # NumPy's own would lose the names
        return type(self), (self.tolist(), self.names)

    def asdict(self) -> dict[str, float]:
        """The values as a dict {name: value}."""
        return dict(zip(self.names, self.tolist(), strict=True))


class BaseModel(Shown):
    """Names and parameters; a model adds its functions."""

    name: str
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    parameters: Sequence[Parameter]

    @cached_property
    def nu(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @cached_property
    def ny(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of theta, in order."""
        return tuple(p.name for p in self.parameters)

    @cached_property
    def lower(self) -> Array:
        """Lower bounds (n_theta,)."""
        return np.array([p.bounds[0] for p in self.parameters], dtype=float)

    @cached_property
    def upper(self) -> Array:
        """Upper bounds (n_theta,)."""
        return np.array([p.bounds[1] for p in self.parameters], dtype=float)

    @cached_property
    def _record(self) -> Any:
        return namedtuple("theta", self.parameter_names)  # noqa: PYI024 - fields are dynamic

    @cached_property
    def checked(self) -> WeakSet[Any]:
        """Series on which the model's functions were checked; see :mod:`engine.statespace.checks`."""
        return WeakSet()

    @cached_property
    def derived(self) -> dict[str, Any]:
        """Other forms of the model that algorithms made from it, kept so that each is made once."""
        return {}

    def evaluated(
        self, name: str, regular: Callable[[Any], Regular], shapes: Sequence[tuple[int, ...]]
    ) -> ModelFunction:
        """The function ``name`` of the model, with what is known of the calls that it takes.

        ``regular`` makes of it one that gives its results their regular shapes, for one row ``shapes``.
        """
        bounds = (self.lower, self.upper)
        return ModelFunction(regular, getattr(self, name), shapes, self.name, name, bounds)

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled: the model's fields, not what was found out from them."""
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    def record(self, theta: Sequence[Any] | Array) -> Any:
        """The parameter vector (n_theta,) as the record that the model's functions get as ``theta``."""
        return self._record(*(theta.tolist() if isinstance(theta, np.ndarray) else theta))

    def records(self, thetas: Array, copies: int = 1) -> Any:
        """The parameter vectors (K, n_theta) as the record of K ``copies`` rows, ``copies`` of each in turn.

        Fields that are the same in all rows are numbers, the others arrays (K copies,).
        """
        fields: list[Any] = thetas[0].tolist()
        for i in np.flatnonzero((thetas != thetas[0]).any(axis=0)):
            fields[i] = np.repeat(thetas[:, i], copies)
            fields[i].setflags(write=False)  # a model may remember what belongs to it
        return self.record(fields)

    def theta(self, values: ThetaLike = None) -> Theta:
        """A full parameter vector from None (defaults), {name: value} or (n_theta,) values.

        Raises OptionError naming the parameter that is unknown, not finite or out of bounds.
        """
        out = np.array([p.default for p in self.parameters], dtype=float)
        own = self.parameter_names
        if isinstance(values, Theta) and values.names != own and {*values.names} == {*own}:
            values = values.asdict()  # of a model with the same parameters in another order
        if isinstance(values, Mapping):
            for name, value in values.items():
                out[self.index(name)] = _numbers(value, name, 1)[0]
        elif values is not None:
            given = _numbers(values, "theta")
            if given.size != out.size:
                raise OptionError(
                    f"theta has {given.size} values; model '{self.name}' has {out.size} parameters: "
                    f"{', '.join(self.parameter_names)}",
                    "theta",
                )
            out[:] = given
        for p, value in zip(self.parameters, out, strict=True):
            if not p.bounds[0] <= value <= p.bounds[1]:  # also catches NaN
                raise OptionError(
                    f"parameter '{p.name}' = {value:g} is not within [{p.bounds[0]:g}, "
                    f"{p.bounds[1]:g}] {p.unit}".rstrip(),
                    p.name,
                )
        return Theta(out, self.parameter_names)

    def index(self, name: str) -> int:
        """Position of a parameter in theta. Raises OptionError for an unknown name."""
        try:
            return self.parameter_names.index(name)
        except ValueError:
            raise OptionError(
                f"model '{self.name}' has no parameter '{name}'; it has "
                f"{', '.join(self.parameter_names) or 'none'}",
                name,
            ) from None

    def at_bounds(self, theta: ThetaLike, free: Sequence[str]) -> tuple[str, ...]:
        """Those of the ``free`` parameters that are at a bound."""
        return tuple(self._sides(theta, free))

    def stopped_by_bounds(
        self, theta: ThetaLike, free: Sequence[str], ties: Ties = NONE
    ) -> tuple[str, ...]:
        """Those at a bound that the data draw there or beyond: none for which others make up (``ties``)."""
        return tuple(ties.held(self._sides(theta, free)))

    def _sides(self, theta: ThetaLike, free: Sequence[str]) -> dict[str, int]:
        """The ``free`` parameters at a bound, 1 at the upper and -1 at the lower, in the order of ``free``."""
        sides = {}
        for p, value in zip(self.parameters, self.theta(theta).tolist(), strict=True):
            near = AT_BOUND * max(abs(value), abs(p.default), p.scale)
            for bound, side in zip(p.bounds, (-1, 1), strict=True):
                if abs(value - bound) <= near:
                    sides[p.name] = side
        return {name: sides[name] for name in free if name in sides}

    def held_in_words(self, theta: ThetaLike, free: Sequence[str], ties: Ties = NONE) -> str:
        """A sentence about those of the ``free`` parameters that a bound has stopped; empty where none is."""
        at = self.stopped_by_bounds(theta, free, ties)
        low = {p.name for p in self.parameters if p.bounds[0] == 0.0 < p.bounds[1]}
        values = dict(zip(self.parameter_names, self.theta(theta).tolist(), strict=True))
        middle = {p.name: 0.5 * p.bounds[1] for p in self.parameters}
        little = {
            p.name
            for p in self.parameters
            if 0.0 < p.bounds[0] <= NEXT_TO_NOTHING * p.default and values[p.name] < p.default
        }
        return held_by_bounds(at, [name for name in low if values[name] < middle[name]], little)

    def hardly_known(self, theta: ThetaLike, errors: Mapping[str, float]) -> tuple[str, ...]:
        """Parameters of which data tell less than their bounds do, given finite standard ``errors`` by name."""
        values = self.theta(theta).asdict()
        furthest = {
            p.name: max(abs(values[p.name] - bound) for bound in p.bounds) for p in self.parameters
        }
        return tuple(name for name, error in errors.items() if furthest[name] <= error < np.inf)

    def free_indices(self, free: Sequence[str] | None) -> NDArray[np.intp]:
        """Positions of the free parameters; None means all of them. Raises OptionError."""
        if free is None:
            return np.arange(len(self.parameters))
        if isinstance(free, str):
            raise OptionError(
                f"free = '{free}'; a list of names is needed, ['{free}'] of one", "free"
            )
        return np.array(sorted({self.index(name) for name in free}), dtype=np.intp)

    def _view(self) -> View:
        kinds = (
            ("nonlinear state", "nonlinear"),
            ("linear state", "linear"),
            ("state", "states"),
            ("input", "inputs"),
            ("output", "outputs"),
        )
        channels = [
            (kind, name, tidy(unit))
            for kind, field in kinds
            for name, unit in getattr(self, field, {}).items()
        ]
        parameters = [
            (p.name, float(p.default), tidy(p.unit), *map(float, p.bounds), p.description)
            for p in self.parameters
        ]
        return sheet(
            self.name,
            tables().line(getattr(self, "description", "")),
            tables().lines(getattr(self, "equations", ())),
            tables().table(("channel", "name", "unit"), channels),
            tables().table(("parameter", "default", "unit", "from", "to", "meaning"), parameters),
        )


def _numbers(values: object, field: str, size: int | None = None) -> NDArray[np.float64]:
    """Values as numbers (n,), ``size`` of them where that is known. Raises OptionError naming the field."""
    try:
        found = np.asarray(values, dtype=float).ravel()
    except (TypeError, ValueError):
        found = None
    if found is None or size not in (None, found.size):
        wanted = "a number" if size == 1 else "a vector of numbers"
        raise OptionError(f"{field} = {values!r}; {wanted} is needed", field)
    return found
