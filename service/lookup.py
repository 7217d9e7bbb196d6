"""A job as its owner finds it, its result, and its tasks."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from engine.presentation.examination import estimate_document, model_document
from service import serializers
from service.auth import Keys
from service.problems import OUT_OF_TIME, Problem
from service.store import Store
from service.transitions import PRELIMINARY
from service.validation import load


def find_job(store: Store, keys: Keys, job_id: str, caller: str) -> Any:
    """The caller's job; another's is as unknown as one that does not exist. Raises Problem 404."""
    row = store.job(job_id)
    if row is None or (keys.needed and row.owner != caller):
        raise Problem(404, "no-such-job", f"there is no job '{job_id}'")
    return row


def find_result(store: Store, row: Any) -> bytes:
    """The JSON text of a job's result. Raises Problem: why it failed, or that there is none."""
    if row.status == "failed" and not has_estimates(store, row):
        raise Problem.of(json.loads(row.problem))
    if row.removed:
        raise Problem(404, "dismissed", f"of job '{row.id}' {row.message}")
    if row.status != "successful" and (body := store.document(row.seq, PRELIMINARY)) is not None:
        return body
    if row.status == "dismissed":
        stopped = f"job '{row.id}' was stopped before its results"
        raise Problem(404, "dismissed", f"{stopped}; POST /jobs/{row.id}/resume goes on")
    body = store.document(row.seq, "result")
    if body is None:
        detail = f"job '{row.id}' is {row.status}; its results come when it is successful"
        raise Problem(404, "result-not-ready", detail, retry_after=1)
    return body


def has_estimates(store: Store, row: Any) -> bool:
    """Whether a job that is not successful has a result so far: without standard errors, without causes."""
    open_ = row.status in ("accepted", "running") or _ended_early(row)
    return open_ and not row.removed and store.has_document(row.seq, PRELIMINARY)


def _ended_early(row: Any) -> bool:
    """Whether its owner, or its time, ended the job: what it has reached is worth having."""
    return bool(row.status == "dismissed" or (row.status == "failed" and row.cause == OUT_OF_TIME))


def parameter_names(store: Store, row: Any) -> list[str]:
    """Of a job's rows; those of its model, which is asked where no estimate names them yet."""
    if row.estimate:
        return list(json.loads(row.estimate))
    request = store.document(row.seq, "request")
    if row.kind != "estimate" or request is None:
        return []
    try:
        return list(load(json.loads(request)).model.parameter_names)
    except Problem:  # a plug-in that has gone
        return []


def stopped_estimate(store: Store, row: Any) -> dict[str, Any] | None:
    """What an estimation that ended early has reached, by its best start; None where there is nothing."""
    if row.kind != "estimate" or not _ended_early(row) or row.removed:
        return None
    starts = json.loads(row.stages)[0]
    reached = [
        (values[-4], -task.task)
        for task, values in store.tasks(row.seq)[:starts]
        if values is not None and np.isfinite(values[-4])
    ]
    if not reached:
        return None
    request = json.loads(store.document(row.seq, "request") or b"null")
    job = load(request)
    ks, rows = store.rows(row.seq, -max(reached)[1])
    theta = rows[-1][: len(job.model.parameters)]
    more = f" (POST /jobs/{row.id}/resume with more run_seconds)"
    why = f": {json.loads(row.problem)['detail']}{more}" if row.status == "failed" else ""
    return {
        "model": model_document(job.model),
        "estimate": estimate_document(
            job.model, theta, job.free or job.model.parameter_names, None
        ),
        "outcome": "stopped",
        "message": f"Stopped after {ks[-1]} of at most {request['options']['iterations']} iterations{why}.",
        "trace": serializers.trace(list(job.model.parameter_names), ks, rows).model_dump(),
        **({"notes": job.request.notes} if job.request.notes else {}),
    }
