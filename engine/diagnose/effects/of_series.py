"""What a series tells of the channels of a model: the setting for which effects are made."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.data.joined import apart, overlapping, starts_of
from engine.data.lattice import VISIBLE, lattice_step, sample_noise
from engine.data.series import Series
from engine.diagnose.effects.setting import Record, Setting
from engine.filters.sigma_point import moment_path
from engine.statespace.model import Array, MixedModel


def setting_for(model: MixedModel, series: Series, theta: Array) -> Setting:
    """Typical sizes of every channel, from the data and the filter's means.

    ``theta`` (n_theta,); of a refined series the samples are what is looked at.
    """
    path = moment_path(model, theta, series)
    rows = series.samples
    values: dict[str, Array] = {}
    for i, name in enumerate([*model.nonlinear, *model.linear]):
        values[name] = path.filtered[rows, i]
    for i, name in enumerate(model.inputs):
        values[name] = series.u[rows, i]
    resolution: dict[str, float] = {}
    for i, name in enumerate(model.outputs):
        values[name] = series.y[rows, i]
        seen = values[name][~np.isnan(values[name])]
        step = lattice_step(seen)
        if step is not None and step >= VISIBLE * sample_noise(seen):
            resolution[name] = step
    t = series.t[rows]
    if series.dt is not None:
        steps = np.full(len(t) - 1, series.substeps * series.dt)
    else:
        steps = np.diff(t)
        into = np.searchsorted(rows, np.array(series.begins, dtype=np.intp)) - 1
        steps[into] = np.median(np.delete(steps, into))  # none is made into another record
    return Setting(
        model,
        {name: _spread(value) for name, value in values.items()},
        (float(t.min()), float(t.max())),
        float(np.median(steps)),
        tuple(name for name in series.extra_names if name in model.inputs),
        resolution,
        Record(values, t, np.append(steps, steps[-1]), np.asarray(theta, dtype=float)),
        substeps=series.substeps,
        hold=series.hold,
        time_unit=series.time_unit,
        regular=series.dt is not None,
        later=later_of(apart(series)),
        starts=starts_of(apart(series)),
    )


def later_of(records: Sequence[Series]) -> tuple[float, ...]:
    """The times at which a further record begins anew, as of :func:`starts_of`; none where two overlap."""
    return () if overlapping(records) else starts_of(records)[1:]


def _spread(values: Array) -> float:
    """Standard deviation about the mean; of a constant channel its value, 1 where that is zero."""
    seen = values[np.isfinite(values)]
    if not seen.size:
        return 1.0
    if np.ptp(seen) > 0.0:
        return float(seen.std())
    return abs(float(seen[0])) or 1.0
