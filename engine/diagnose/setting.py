"""The model for which effects are made, where they may enter it, and the sizes its data have."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from engine.diagnose.effect import Effect
from engine.diagnose.lattice import VISIBLE, lattice_step, sample_noise
from engine.model import Array, MixedModel
from engine.moment_filter import moment_path
from engine.series import Series


@dataclass(frozen=True)
class Setting:
    """The model for which effects are made, with what its data tell about sizes.

    ``scale`` maps a channel to its typical size (standard deviation) in its unit, 1 where unknown;
    ``span`` is the first and last time in seconds; ``dt`` the median time step. ``extra`` are those
    inputs that were recorded but that the model does not use; ``resolution`` maps an output to the
    step its readings come in, where they show one.
    """

    model: MixedModel
    scale: Mapping[str, float] = field(default_factory=dict)
    span: tuple[float, float] = (0.0, 100.0)
    dt: float = 1.0
    extra: tuple[str, ...] = ()
    resolution: Mapping[str, float] = field(default_factory=dict)

    def limits(self, low: float, high: float, least: float = 0.0) -> tuple[float, float]:
        """Bounds (low, high) taken from the data, (least, inf) where nothing is known of them."""
        return (low, high) if self.scale else (least, float("inf"))

    def size(self, channel: str) -> float:
        """The channel's typical size, 1 where unknown."""
        value = float(self.scale.get(channel, 1.0))
        return value if value > 0.0 else 1.0

    @property
    def states(self) -> dict[str, str]:
        """All states with their units."""
        return {**self.model.nonlinear, **self.model.linear}

    @property
    def targets(self) -> list[str]:
        """States whose equations may be wrong: all but those that hold by definition."""
        return [name for name in self.states if name not in self.model.kinematic]

    def is_rate(self, state: str) -> bool:
        """Whether a state is the rate of another one, as a velocity is."""
        return any(rate == state for rate in self._rates)

    def has_rate(self, state: str) -> bool:
        """Whether another state is this one's rate, as a position has."""
        return state in self.model.kinematic

    @property
    def _rates(self) -> list[str]:
        F, states = _structure(self.model), list(self.states)
        rows = [states.index(name) for name in self.model.kinematic]
        return [states[j] for i in rows for j in np.flatnonzero(F[i]) if i != j]

    def rate(self, target: str, divided_by: str = "") -> str:
        """Unit of what enters a state's equation per second, divided by another unit."""
        unit = f"{self.unit(target)}/s"
        if divided_by.startswith("("):  # a power of a unit in brackets
            return f"{unit}/{divided_by}"
        return f"{unit}/({divided_by})" if divided_by else unit

    def unit(self, channel: str) -> str:
        """Unit of a state, input or output."""
        model = self.model
        return {**model.nonlinear, **model.linear, **model.inputs, **model.outputs}[channel]


# A maker: (setting, channel) -> the effect, or None where the channel is not of its sort.
Maker: TypeAlias = Callable[[Setting, str], Effect | None]


# Which channels a maker is tried on when all effects of a model are listed.
Channels: TypeAlias = Callable[[Setting], Iterator[str]]


# A kind as the shipped modules list it.
Kind: TypeAlias = tuple[str, Maker, Channels]


def each_state(setting: Setting) -> Iterator[str]:
    """Every state whose equation may be wrong."""
    yield from setting.targets


def each_output(setting: Setting) -> Iterator[str]:
    """Every output."""
    yield from setting.model.outputs


def each_input(setting: Setting) -> Iterator[str]:
    """Every input that the model uses."""
    yield from (name for name in setting.model.inputs if name not in setting.extra)


def each_parameter(setting: Setting) -> Iterator[str]:
    """Every parameter of the model."""
    yield from setting.model.parameter_names


def each_moved(setting: Setting) -> Iterator[str]:
    """Every state that an input or another state moves: not a disturbance of its own."""
    model = setting.model
    F = _structure(model)
    by_inputs = _moved_by_inputs(model)
    for i, name in enumerate(setting.states):
        if name in setting.targets and (by_inputs[i] or np.delete(F[i], i).any()):
            yield name


def each_pair(setting: Setting) -> Iterator[str]:
    """A state in its own equation, and ``source->target`` where one already feeds the other."""
    states = list(setting.states)
    F = np.abs(_structure(setting.model))
    for i, source in enumerate(states):
        if source in setting.targets:
            yield source
        for j, target in enumerate(states):
            if i != j and target in setting.targets and (F[j, i] > 0.0 or F[i, j] > 0.0):
                yield f"{source}->{target}"


def pair(setting: Setting, channel: str) -> tuple[str, str] | None:
    """(source, target) of a channel, None where they are not states of the model."""
    source, _, target = channel.partition("->")
    target = target or source
    return (source, target) if {source, target} <= set(setting.states) else None


def _structure(model: MixedModel) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Size of d x_{t+1} / d x_t at some points: which state feeds which."""
    rng = np.random.default_rng(5)
    record = model.record(model.theta())
    na = model.na
    density = model.start(record).density
    a = np.asarray(density.sample(rng, 16), dtype=float) + 0.1 * rng.standard_normal((16, na))
    u = rng.standard_normal(model.nu)
    F = np.zeros((model.nx, model.nx))
    with np.errstate(all="ignore"):
        f, A, _ = model.transition(a, u, 0.0, 1.0, record)
        F[:, na:] = np.abs(A if A.ndim == 2 else A.max(axis=0))
        for i in range(na):
            moved = a.copy()
            moved[:, i] += 1e-3
            g, B, _ = model.transition(moved, u, 0.0, 1.0, record)
            change = np.abs(g - f).max(axis=0)
            if A.ndim == 3:
                change = change + np.abs(B - A).max(axis=(0, 2))
            F[:, i] = np.where(change > 1e-9, change, 0.0)
    return np.nan_to_num(F)


def _moved_by_inputs(model: MixedModel) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which states (nx,) a change of some input changes at once."""
    record = model.record(model.theta())
    a = np.zeros((1, model.na))
    u = np.full(model.nu, 0.5)
    moved = np.zeros(model.nx, dtype=bool)
    with np.errstate(all="ignore"):
        f, A, _ = model.transition(a, u, 0.0, 1.0, record)
        for k in range(model.nu):
            more = u.copy()
            more[k] += 1.0
            g, B, _ = model.transition(a, more, 0.0, 1.0, record)
            moved |= (g != f).any(axis=0) | (B != A).any(axis=-1).reshape(-1, model.nx).any(axis=0)
    return moved


def setting_for(model: MixedModel, series: Series, theta: Array) -> Setting:
    """Typical sizes of every channel, from the data and the filter's means."""
    path = moment_path(model, theta, series)
    scale: dict[str, float] = {}
    for i, name in enumerate([*model.nonlinear, *model.linear]):
        scale[name] = float(np.sqrt(np.mean(path.filtered[:, i] ** 2)))
    for i, name in enumerate(model.inputs):
        scale[name] = float(np.sqrt(np.mean(series.u[:, i] ** 2)))
    resolution: dict[str, float] = {}
    for i, name in enumerate(model.outputs):
        seen = series.y[series.observed[:, i], i]
        scale[name] = float(np.sqrt(np.mean(seen**2))) if len(seen) else 1.0
        step = lattice_step(seen)
        if step is not None and step >= VISIBLE * sample_noise(seen):
            resolution[name] = step
    return Setting(
        model,
        scale,
        (float(series.t[0]), float(series.t[-1])),
        float(np.median(series.steps)),
        tuple(name for name in series.extra_names if name in model.inputs),
        resolution,
    )
