"""The four base models and the experiment made with each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.models.registry import get_model
from engine.simulation.simulate import simulate
from engine.statespace.model import Array, MixedModel

TEST_SHARE = 0.25  # held-out rows for each row of the training part
SETTING_ROWS = 1000  # of the clean series that tells the effects' typical sizes


@dataclass(frozen=True)
class Base:
    """A registered model, its sampling time in seconds, what is estimated, and its inputs.

    ``inputs(T, rng)`` gives u (T, nu), None for a model without inputs.
    """

    name: str
    dt: float
    inputs: Callable[[int, np.random.Generator], Array] | None = None
    known: tuple[str, ...] = ()

    @property
    def model(self) -> MixedModel:
        """The model."""
        return get_model(self.name)

    @property
    def free(self) -> list[str]:
        """The parameters that are estimated."""
        return [name for name in self.model.parameter_names if name not in self.known]

    def draw(
        self, rows: int, rng: np.random.Generator, model: MixedModel, theta: Array
    ) -> tuple[Series, Series]:
        """Training part of ``rows`` rows and the held-out part that follows it.

        Raises ModelError where the simulation runs away.
        """
        T = rows + int(TEST_SHARE * rows)
        u = None if self.inputs is None else self.inputs(T, rng)
        series = simulate(model, theta, T, rng, u=u, dt=self.dt).series
        return series.part(0, rows), series.part(rows, T)


def _steps(high: float, hold: int) -> Callable[[int, np.random.Generator], Array]:
    """Steps of random height in +-``high``, each held for ``hold`` samples."""

    def inputs(T: int, rng: np.random.Generator) -> Array:
        heights = rng.uniform(-high, high, size=T // hold + 1)
        return np.asarray(np.repeat(heights, hold)[:T, None])

    return inputs


BASES = {
    base.name: base
    for base in (
        Base("linear-2", 1.0),
        Base("mixed-4", 1.0),
        Base("servo", 0.02, _steps(8.0, 25), known=("gtau",)),
        Base("structure", 0.05, _steps(1.0, 8)),
    )
}


@lru_cache
def typical(name: str, rows: int) -> Setting:
    """Typical sizes of a base's channels, from one clean series; its span is that of ``rows`` rows."""
    base = BASES[name]
    rng = np.random.default_rng(1)
    train, _ = base.draw(SETTING_ROWS, rng, base.model, np.asarray(base.model.theta()))
    found = setting_for(base.model, train, np.asarray(base.model.theta()))
    return Setting(base.model, found.scale, (0.0, (rows - 1) * base.dt), base.dt)
