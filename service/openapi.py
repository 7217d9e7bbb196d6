"""What the calls have in common in the OpenAPI document: parameters, problems, links between calls."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Header, Path, Query

from service.problems import MEDIA_TYPE
from service.responses import ProblemOut

JobId = Annotated[str, Path(max_length=64, description="the job's `jobID`")]
Points = Annotated[
    int | None, Query(ge=2, le=10**6, description="about this many rows; extremes are kept")
]
IdempotencyKey = Annotated[
    str | None, Header(min_length=1, max_length=200, description="a repeat returns the first job")
]


# What can be done with a job that was made, as OpenAPI tells it.
LINKS = {
    name: {"operationId": f"{name}_jobs__job_id__{rest}", "parameters": {"job_id": "$response.body#/jobID"}}
    for name, rest in (
        ("job", "get"), ("job_trace", "trace_get"), ("asked", "request_get"),
        ("results", "results_get"), ("stop", "stop_post"), ("resume", "resume_post"), ("dismiss", "delete"),
        ("tasks", "tasks_get"), ("report", "report_get"),
    )
}  # fmt: skip


def problem_answers(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """OpenAPI entries for problem documents."""
    content = {MEDIA_TYPE: {"schema": ProblemOut.model_json_schema()}}
    return {status: {"description": "problem", "content": content} for status in statuses}
