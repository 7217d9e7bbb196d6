"""A long record is searched on windows of it: the search takes as long as its rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.data.series import Series
from engine.diagnose.free_run.oversampled import fewer_samples
from engine.errors import EngineError
from engine.filters.sigma_point import moment_path
from engine.simulation.problem import FreeRunProblem
from engine.statespace.model import MixedModel, ThetaLike

MOST_ROWS = 4000  # of all windows together; steps between samples count, but ...
MOST_STEPS = 4  # ... up to so many a sample, windows have as many samples
MOST_WHOLE = 20_000  # rows of records that are searched whole where parts of them tell too little
WINDOWS = 4
WIDE = 0.3  # of the standard deviation of a state over a record
LONG, STRETCH = 10_000, 3000  # rows from which on the likelihood searches a stretch, and its length


def windows(records: Sequence[Series], most: int = MOST_ROWS) -> list[Series]:
    """The records, or windows of the only one: the one that moves most, the least, and two between.

    Of each of several its share, the stretch that moves most. ``most`` rows where each is a sample.
    """
    rows = sum(len(one) for one in records)
    most *= min(records[0].substeps, MOST_STEPS)
    if rows <= most:
        return list(records)
    if len(records) > 1:
        return [one.part(*stretch(one, 0, max(most * len(one) // rows, 2))) for one in records]
    (longest,) = records
    length = most // WINDOWS // longest.substeps * longest.substeps
    n = len(longest) // length
    if n <= WINDOWS:
        return [longest.part(*stretch(longest, 0, most))]
    parts = [longest.part(k * length, (k + 1) * length) for k in range(n)]
    parts = [part for part in parts if part.observed.any()]
    order = sorted(range(len(parts)), key=lambda k: activity(parts[k], longest))
    chosen = {order[i] for i in np.linspace(0, len(order) - 1, WINDOWS).round().astype(int)}
    return [parts[k] for k in sorted(chosen)]


def telling(
    model: MixedModel, theta: ThetaLike, free: Sequence[str], records: Sequence[Series]
) -> list[Series]:
    """:func:`windows`, fewer samples of the records where that will do, or all of these.

    All where free parameters are silent on windows that the records tell: so it is with a table of which every
    part of a record visits another entry.
    """
    parts = windows(records)
    if parts == list(records):
        return parts
    fewer = fewer_samples(model, theta, records, MOST_ROWS)
    if fewer is not None:
        return fewer
    return list(records) if _too_little(model, theta, free, parts, records) else parts


def _too_little(
    model: MixedModel,
    theta: ThetaLike,
    free: Sequence[str] | None,
    parts: Sequence[Series],
    records: Sequence[Series],
) -> bool:
    """Whether the records, where they can be searched whole, tell free parameters that parts of them do not."""
    if parts == list(records) or sum(map(len, records)) > MOST_WHOLE:
        return False
    return bool(_silent(model, theta, free, parts) - _silent(model, theta, free, records))


def _silent(
    model: MixedModel, theta: ThetaLike, free: Sequence[str] | None, records: Sequence[Series]
) -> set[str]:
    """Free parameters that do not change the free run of any of the records; none where there is no run."""
    indices = model.free_indices(free)
    problem = FreeRunProblem(model, list(records), model.theta(theta), indices)
    try:
        problem.look_for_silent()
    except (EngineError, np.linalg.LinAlgError):
        return set()
    return set(problem.names(problem.silent))


def stretch(series: Series, long: int = LONG, rows: int = STRETCH) -> tuple[int, int]:
    """First row and end of the stretch of a long series that moves most; samples stay whole."""
    length = rows // series.substeps * series.substeps
    if len(series) <= long or not length:
        return 0, len(series)
    firsts = range(
        0, len(series) - length + 1, max(length // 2, 1) // series.substeps * series.substeps
    )
    best = max(firsts, key=lambda first: activity(series.part(first, first + length), series))
    return best, best + length


def rows_searched(
    model: MixedModel, theta: ThetaLike, free: Sequence[str] | None, series: Series
) -> tuple[int, int]:
    """First row and end of what the likelihood searches: :func:`stretch`, or as many rows from the first on.

    The latter where the model knows where a record begins, which is not where a stretch does. All rows where
    free parameters are silent on these that the record tells: a search beside values that nothing was
    estimated of finds what their errors look like.
    """
    begin, end = stretch(series)
    if end - begin == len(series):
        return begin, end
    if begin and not _begins_anywhere(model, theta, series.part(0, end - begin)):
        begin, end = 0, end - begin
    if _too_little(model, theta, free, [series.part(begin, end)], [series]):
        return 0, len(series)
    return begin, end


def _begins_anywhere(model: MixedModel, theta: ThetaLike, part: Series) -> bool:
    """Whether the first state's density is as wide, nearly, as the states go on a part of a record."""
    try:
        path = moment_path(model, np.asarray(model.theta(theta)), part)
    except (EngineError, np.linalg.LinAlgError):
        return False
    wide = np.sqrt(np.diagonal(path.P_predicted[0]))
    return bool((wide >= WIDE * np.std(path.filtered, axis=0)).all())


def activity(part: Series, whole: Series) -> float:
    """How far its readings and inputs reach, in their standard deviations over the whole record."""
    total = 0.0
    for own, every in ((part.y, whole.y), (part.u, whole.u)):
        seen = ~np.isnan(every).all(axis=0)
        own, every = own[:, seen], every[:, seen]
        spread = np.nanstd(every, axis=0)
        reach = np.nanmax(np.abs(own - np.nanmean(every, axis=0)), axis=0, initial=0.0)
        total += float(np.sum(np.nan_to_num(reach[spread > 0.0] / spread[spread > 0.0])))
    return total
