"""The JSON calls; conventions of OGC API - Processes where they apply."""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import APIRouter, Body, Path, Query, Response
from fastapi.responses import JSONResponse

import engine
from engine.errors import OptionError
from service import documents, kinds
from service.prepare import check_limits, dump, prepare
from service.problems import MEDIA_TYPE, Problem
from service.schemas import (
    EXAMPLES,
    JobList,
    JobRequest,
    JobStatus,
    Link,
    ModelList,
    ModelOut,
    ProblemOut,
    Results,
    Status,
    Trace,
)
from service.settings import Settings
from service.store import Store
from service.supervisor import Supervisor

JobId = Annotated[str, Path(max_length=64, description="the job's `jobID`")]


def problem_answers(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """OpenAPI entries for problem documents."""
    content = {MEDIA_TYPE: {"schema": ProblemOut.model_json_schema()}}
    return {status: {"description": "problem", "content": content} for status in statuses}


def router(store: Store, supervisor: Supervisor, settings: Settings) -> APIRouter:
    """All calls, on a store."""
    api = APIRouter()

    def find(job_id: str) -> Any:
        row = store.job(job_id)
        if row is None:
            raise Problem(404, "no-such-job", f"there is no job '{job_id}'")
        return row

    @api.get("/", summary="Service document")
    def service() -> dict[str, Any]:
        rels = {"self": "/", "service-desc": "/openapi.json", "models": "/models", "jobs": "/jobs"}
        return {
            "title": "rbps",
            "description": "Identification of mixed linear/nonlinear state-space models",
            "links": [{"rel": rel, "href": href} for rel, href in rels.items()],
        }

    @api.get("/models", summary="Registered models")
    def models() -> ModelList:
        found = [documents.model(engine.get_model(name)) for name in engine.model_names()]
        links = [Link(href="/models", rel="self")]
        return ModelList(models=found, broken_plugins=engine.plugin_errors(), links=links)

    @api.get("/models/{name}", summary="One model", responses=problem_answers(404, 422))
    def model(name: Annotated[str, Path(max_length=200)]) -> ModelOut:
        try:
            return documents.model(engine.get_model(name))
        except OptionError as error:
            raise Problem(404, "no-such-model", str(error)) from None

    @api.post(
        "/jobs",
        status_code=201,
        summary="Submit a job",
        response_model=JobStatus,
        responses=problem_answers(400, 413, 422, 429),
    )
    def submit(request: Annotated[JobRequest, Body(openapi_examples=EXAMPLES)]) -> Response:
        check_limits(request, settings)
        job = prepare(request)
        counts = store.counts()
        if counts.get("accepted", 0) + counts.get("running", 0) >= settings.max_queue:
            detail = f"{settings.max_queue} jobs wait or run already; try again later"
            raise Problem(429, "queue-full", detail, retry_after=30)
        job_id = store.create(request.kind, job.model.name, dump(request), kinds.steps(job))
        supervisor.wake()
        body = documents.job_status(find(job_id)).model_dump()
        return JSONResponse(body, 201, {"Location": f"/jobs/{job_id}"})

    @api.get("/jobs", summary="Jobs, newest first", responses=problem_answers(422))
    def jobs(
        status: Annotated[list[Status] | None, Query()] = None,
        model: Annotated[str | None, Query(max_length=200)] = None,
        limit: Annotated[int, Query(ge=1, le=1000)] = 50,
        cursor: Annotated[int | None, Query(ge=1, le=2**31 - 1)] = None,
    ) -> JobList:
        rows = store.jobs(limit + 1, cursor, status or (), model)
        links = [Link(href="/jobs", rel="self")]
        if len(rows) > limit:
            query = f"limit={limit}&cursor={rows[limit - 1].seq}"
            query += "".join(f"&status={s}" for s in status or ())
            query += f"&model={model}" if model else ""
            links.append(Link(href=f"/jobs?{query}", rel="next"))
        return JobList(jobs=[documents.job_status(row) for row in rows[:limit]], links=links)

    @api.get("/jobs/{job_id}", summary="Status", responses=problem_answers(404))
    def job(job_id: JobId) -> JobStatus:
        return documents.job_status(find(job_id))

    @api.get("/jobs/{job_id}/trace", summary="Every iteration", responses=problem_answers(404))
    def job_trace(
        job_id: JobId,
        after: Annotated[int, Query(ge=-1, le=2**31 - 1, description="only k > after")] = -1,
    ) -> Trace:
        row = find(job_id)
        ks, rows = store.rows(row.seq, after=after)
        names = list(json.loads(row.estimate)) if row.estimate else _names(row.model)
        return documents.trace(names, ks, rows)

    @api.get(
        "/jobs/{job_id}/results",
        summary="Results, or why there are none",
        response_model=Results,
        response_model_exclude_unset=True,
        responses=problem_answers(404, 409, 422, 500),
    )
    def results(job_id: JobId) -> Response:
        row = find(job_id)
        if row.status == "failed":
            problem = json.loads(row.problem)
            return JSONResponse(problem, problem["status"], media_type=MEDIA_TYPE)
        body = store.document(row.seq, "result")
        if body is None:
            detail = f"job '{job_id}' is {row.status}; its results come when it is successful"
            if row.status == "dismissed":
                raise Problem(404, "dismissed", f"job '{job_id}' was dismissed; it has no results")
            raise Problem(404, "result-not-ready", detail, retry_after=1)
        return Response(body, media_type="application/json")

    @api.delete("/jobs/{job_id}", summary="Stop or remove a job", responses=problem_answers(404))
    def dismiss(job_id: JobId) -> JobStatus:
        row = store.dismiss(job_id)
        if row is None:
            raise Problem(404, "no-such-job", f"there is no job '{job_id}'")
        return documents.job_status(row)

    @api.get("/livez", summary="The process is alive")
    def livez() -> dict[str, str]:
        return {"status": "alive"}

    return api


def _names(model: str) -> list[str]:
    try:
        return list(engine.get_model(model).parameter_names)
    except OptionError:  # a plug-in that has gone
        return []
