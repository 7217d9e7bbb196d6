"""Where and when a force acts that no effect of the catalogue explains: its smoothed course."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.diagnose.refits import Refit
from engine.diagnose.runs import smoothed
from engine.model import Array
from engine.moment_filter import moment_path
from engine.series import Series
from engine.words import number, with_unit


@dataclass(frozen=True, eq=False)
class UnnamedForce:
    """The force on ``target`` at times ``t`` (T,): ``mean`` and standard deviation ``sd`` (T,) in ``unit``."""

    target: str
    unit: str
    t: Array
    mean: Array
    sd: Array

    @property
    def sentence(self) -> str:
        """Where it acts, how strong, and when it is strongest."""
        clear = np.abs(self.mean) > 2.0 * self.sd
        size = float(np.sqrt(np.mean(self.mean**2)))
        text = f"An unnamed force acts on {self.target}: {with_unit(size, self.unit)} rms"
        if not clear.any():
            return f"{text}, at no time clearly different from zero by itself."
        strongest = int(np.argmax(np.where(clear, np.abs(self.mean), 0.0)))
        first, last = _around(
            clear & (np.sign(self.mean) == np.sign(self.mean[strongest])), strongest
        )
        return (
            f"{text}, clearly different from zero for {100.0 * clear.mean():.0f} % of the time, strongest "
            f"({with_unit(float(self.mean[strongest]), self.unit)}) at t = "
            f"{number(float(self.t[strongest]), 4)} s, within a stretch from {number(float(self.t[first]), 4)} "
            f"to {number(float(self.t[last]), 4)} s."
        )


def unnamed_force(refit: Refit, series: Series) -> UnnamedForce:
    """The smoothed course of a refitted generic force; its state is the last linear one."""
    model = refit.fit.model
    means, covariances = smoothed(moment_path(model, np.asarray(refit.fit.theta), series))
    name, unit = list(model.linear.items())[-1]
    return UnnamedForce(
        refit.effect.channel.partition(",")[0] or name,
        unit,
        np.asarray(series.t),
        means[:, -1],
        np.sqrt(np.maximum(covariances[:, -1, -1], 0.0)),
    )


def _around(mask: Array, at: int) -> tuple[int, int]:
    """First and last row of the stretch of True around a row."""
    off = np.flatnonzero(~np.asarray(mask, dtype=bool))
    before, after = off[off < at], off[off > at]
    return (
        int(before[-1]) + 1 if before.size else 0,
        int(after[0]) - 1 if after.size else len(mask) - 1,
    )
