"""What acts only where the record has no rows is no cause: nobody knows what the inputs did there.

A simulation holds them over a gap. What it gets wrong by that comes out as a pulse of a force, or as a
parameter that was another one for a while, at a time that lies within the gap.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from engine.data.gaps import gaps, inputs_over_gaps
from engine.data.series import Series
from engine.diagnose.judging.findings import Cause
from engine.words import moment, number

WITHIN = 0.9  # of the time for which it acts


def in_gaps(causes: Sequence[Cause], series: Series) -> list[str]:
    """A sentence for each cause that acts for a while, and then within a gap of the inputs."""
    if series.begins or not inputs_over_gaps(dict.fromkeys(series.u_names, ""), series):
        return []
    clock, out = series.time_unit, []
    for cause in causes:
        for row in gaps(series):
            before, after = (float(t) for t in series.t[[row, row + series.substeps]])
            if _within(cause.parameters, before, after):
                begin = moment(before, series.usual_step, clock)
                out.append(
                    f"{cause.effect} acts where there are no rows, for {number(after - before)} {clock} after "
                    f"t = {begin}: it makes up for inputs that are not known there, and is not the cause."
                )
    return out


def _within(parameters: Mapping[str, float], before: float, after: float) -> bool:
    """Whether what has these parameters begins and is over again, nearly all of it between two times."""
    times = {name.rpartition("_")[2]: value for name, value in parameters.items()}
    if "time" not in times or not times.keys() & {"end", "width"}:
        return False
    start = times["time"]
    end = times.get("end", start + times.get("width", 0.0))
    inside = min(end, after) - max(start, before)
    return inside > 0.0 and inside >= WITHIN * (end - start)
