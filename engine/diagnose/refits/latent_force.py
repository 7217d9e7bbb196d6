"""Where and when a force acts that no effect of the catalogue explains: its smoothed course."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.data.series import Series
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.symptoms.runs import smoothed
from engine.filters.sigma_point import moment_path
from engine.statespace.model import Array
from engine.units import SECOND
from engine.words import estimate, moment, percent, with_unit

CLEAR = 2.0  # standard deviations off zero
BY_CHANCE = 0.05  # of the time; so often a course is CLEAR that is none
BELIEVED = 10.0  # standard deviations of the fitted process, which no course of it leaves


@dataclass(frozen=True, eq=False)
class UnnamedForce:
    """The force on ``target`` at times ``t`` (T,): ``mean``, standard deviation ``sd`` (T,) in ``unit``."""

    target: str
    unit: str
    t: Array
    mean: Array
    sd: Array
    time_unit: str = SECOND

    @property
    def sentence(self) -> str:
        """Where it acts, how strong, and when it is strongest; no size where none is told from zero."""
        clear = np.abs(self.mean) > CLEAR * self.sd
        if not clear.mean() > BY_CHANCE:
            return (
                f"An unnamed force on {self.target} explains part of it, but is hardly ever clearly different "
                "from zero by itself."
            )
        size = float(np.sqrt(np.mean(self.mean**2)))
        strongest = int(np.argmax(np.where(clear, np.abs(self.mean), 0.0)))
        first, last = _around(
            clear & (np.sign(self.mean) == np.sign(self.mean[strongest])), strongest
        )
        peak = estimate(float(self.mean[strongest]), float(self.sd[strongest]), self.unit)
        step = float(np.median(np.diff(self.t)))
        at = moment(float(self.t[strongest]), step, self.time_unit)
        start = moment(float(self.t[first]), step)
        end = moment(float(self.t[last]), step, self.time_unit)
        within = "" if first == last else f", within a stretch from {start} to {end}"
        return (
            f"An unnamed force acts on {self.target}: {with_unit(size, self.unit)} rms, clearly different from "
            f"zero for {percent(float(clear.mean()))} of the time, strongest ({peak}) at t = "
            f"{at}{within}."
        )


def unnamed_force(refit: Refit, series: Series) -> UnnamedForce | None:
    """The smoothed course of a refitted generic force; its state is the last linear one.

    None where the data do not determine it: where the refit gives it no variance, or where its course
    leaves what a process of that variance does, which only rounding errors make it do.
    """
    model = refit.fit.model
    if not refit.size > 0.0:
        return None
    means, covariances = smoothed(moment_path(model, np.asarray(refit.fit.theta), series))
    mean, variance = means[:, -1], covariances[:, -1, -1]
    if not np.isfinite(mean).all() or np.abs(mean).max() > BELIEVED * np.sqrt(refit.size):
        return None
    name, unit = list(model.linear.items())[-1]
    return UnnamedForce(
        refit.effect.channel.partition(",")[0] or name,
        unit,
        np.asarray(series.t),
        mean,
        np.sqrt(np.maximum(variance, 0.0)),
        series.time_unit,
    )


def _around(mask: Array, at: int) -> tuple[int, int]:
    """First and last row of the stretch of True around a row."""
    off = np.flatnonzero(~np.asarray(mask, dtype=bool))
    before, after = off[off < at], off[off > at]
    return (
        int(before[-1]) + 1 if before.size else 0,
        int(after[0]) - 1 if after.size else len(mask) - 1,
    )
