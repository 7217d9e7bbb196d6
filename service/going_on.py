"""Whether a job that has ended may go on, and with how many iterations."""

from __future__ import annotations

import json
from typing import Any

from service.problems import Problem, invalid
from service.schemas import ResumeIn

OPEN_ENDED = ("iterations-used-up", "wandered")  # outcomes from which more iterations may lead on


def open_ended(row: Any) -> bool:
    """Whether a successful job is an estimation that more iterations would lead on."""
    return row.status == "successful" and _counts_iterations(row) and row.outcome in OPEN_ENDED


def check_resumed(row: Any, asked: ResumeIn, most: int) -> None:
    """Raise Problem where a job cannot go on as it is asked to; ``most`` iterations are allowed."""
    if row.removed or (row.status == "successful" and not open_ended(row)):
        why = "its data are gone" if row.removed else "it is successful"
        raise Problem(409, "nothing-to-resume", f"job '{row.id}' cannot go on: {why}")
    if (wanted := asked.iterations) is None:
        if row.status == "successful":
            said = f"job '{row.id}' has made all its iterations; give more of them"
            raise Problem(
                409, "nothing-to-resume", f'{said}, as {{"iterations": {2 * row.iterations}}}'
            )
        return
    if not _counts_iterations(row):
        said = "they can be changed of an estimation from one start without a bootstrap only"
        raise invalid("iterations", said)
    if wanted <= row.iteration:
        raise invalid("iterations", f"{wanted} iterations; {row.iteration} are done already")
    if wanted > most:
        raise invalid("iterations", f"{wanted} iterations; this service allows {most}")


def _counts_iterations(row: Any) -> bool:
    """Whether it iterates from one start, and nothing else."""
    return bool(row.kind == "estimate" and json.loads(row.stages) == [1])
