"""The JSON calls; conventions of OGC API - Processes where they apply."""

import json
from functools import partial
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Body, Depends, File, Form, Path, Query, Response, UploadFile
from fastapi import Request as HttpRequest
from fastapi.responses import JSONResponse, PlainTextResponse

import engine
from engine.diagnose.effects.setting import Setting
from engine.errors import OptionError
from engine.models.registry import source_of
from service import metrics, serializers, stages
from service.auth import Keys
from service.bodies import json_route
from service.downsample import keep, thin_results
from service.etags import with_etag
from service.examples import EXAMPLES
from service.file_names import as_typed
from service.going_on import check_resumed
from service.listing import ListQuery
from service.lookup import find_job, find_result, has_estimates, parameter_names, stopped_estimate
from service.openapi import LINKS, IdempotencyKey, JobId, Points, problem_answers
from service.preview import preview
from service.problems import Problem, invalid
from service.responses import (
    JobList,
    JobStatus,
    Link,
    ModelList,
    ModelOut,
    PreviewOut,
    Results,
    Trace,
)
from service.schemas import JobRequest, LabelsIn, ModelReference, Request, ResumeIn, TimeUnit
from service.settings import Settings
from service.store import ENDED, Store, Which
from service.strict_json import dumps
from service.supervisor import Supervisor
from service.uploads import with_files
from service.validation import check_limits, find_model, prepare


def router(store: Store, supervisor: Supervisor, settings: Settings, keys: Keys) -> APIRouter:
    """All calls, on a store."""
    api = APIRouter(
        responses=problem_answers(*keys.refusals, 422), route_class=json_route(settings.max_values)
    )
    Caller = Annotated[str, Depends(keys.dependency)]
    find = partial(find_job, store, keys)
    unknown, unread = problem_answers(404), problem_answers(400, 408, 413, 415)

    def limits(caller: str) -> list[tuple[str | None, int]]:
        own = [(caller, settings.queue_per_key)] if keys.needed else []
        return [(None, settings.max_queue), *own]

    def put(request: Request, caller: str, key: str | None) -> Response:
        check_limits(request, settings)
        job = prepare(request)
        request.model.source = source_of(request.model.name)
        job_id = store.create(
            request.kind,
            job.model.name[:200],
            request.model_dump(),
            stages.steps(job),
            stages.plan(request),
            request.run_seconds,
            caller,
            key,
            limits(caller),
        )
        supervisor.wake()
        body = serializers.job_status(find(job_id, caller)).model_dump()
        return JSONResponse(body, 201, {"Location": f"/jobs/{job_id}"})

    @api.get("/", summary="Service document")
    def service() -> dict[str, Any]:
        rels = {"self": "/", "service-desc": "/openapi.json", "models": "/models", "jobs": "/jobs"}
        return {
            "title": "rbps",
            "description": "Identification of mixed linear/nonlinear state-space models",
            "links": [{"rel": rel, "href": href} for rel, href in rels.items()],
        }

    @api.get("/models", summary="Registered models")
    def models(caller: Caller) -> ModelList:
        found = [serializers.model(engine.get_model(name)) for name in engine.model_names()]
        links = [Link(href="/models", rel="self")]
        return ModelList(models=found, broken_plugins=engine.plugin_errors(), links=links)

    @api.get("/models/{name}", summary="One model", responses=unknown)
    def model(caller: Caller, name: Annotated[str, Path(max_length=200)]) -> ModelOut:
        try:
            return serializers.model(engine.get_model(name))
        except OptionError as error:
            raise Problem(404, "no-such-model", str(error)) from None

    @api.post("/models/extend", summary="A model with effects added to it", responses=unread)
    def extended(caller: Caller, reference: ModelReference) -> ModelOut:
        return serializers.model(find_model(reference, Setting), reference)

    posted: dict[str, Any] = {
        "status_code": 201,
        "response_model": JobStatus,
        "responses": unread | problem_answers(429) | {201: {"links": LINKS}},
    }

    @api.post("/jobs", summary="Submit a job", **posted)
    def submit(
        caller: Caller,
        request: Annotated[JobRequest, Body(openapi_examples=EXAMPLES)],
        idempotency_key: IdempotencyKey = None,
    ) -> Response:
        return put(request, caller, idempotency_key)

    @api.post("/jobs/upload", summary="Submit a job with its data in files", **posted)
    def upload(
        caller: Caller,
        request: Annotated[str, Form(description="as for POST /jobs; the Guide has an example")],
        file: Annotated[list[UploadFile], File(description="CSV, .mat or .npz")],
        idempotency_key: IdempotencyKey = None,
    ) -> Response:
        files: dict[str, bytes] = {}
        for i, one in enumerate(file):
            name = one.filename or f"file{i}"
            if name in files:
                raise invalid("file", f"two files are named '{name}'; give each a name of its own")
            files[name] = one.file.read()
        return put(with_files(request, files, settings.max_values), caller, idempotency_key)

    @api.post("/preview", summary="What a data file holds", responses=unread)
    def look(
        caller: Caller,
        file: Annotated[UploadFile, File(description="CSV, .mat or .npz")],
        t: Annotated[
            str | None, Form(max_length=200, description="column of time stamps; else one named so")
        ] = None,
        time_unit: Annotated[
            TimeUnit | None, Form(description="what times count; else what the file says")
        ] = None,
        by: Annotated[
            str | None, Form(max_length=200, description="column that tells records apart")
        ] = None,
    ) -> PreviewOut:
        name = as_typed(file.filename or "")
        return preview(file.file.read(), name, t, time_unit, settings, by)

    @api.get("/jobs", summary="Jobs, newest first or sorted")
    def jobs(caller: Caller, asked: Annotated[ListQuery, Query()]) -> JobList:
        which = Which(
            asked.status, asked.kind, asked.outcome, asked.tag, asked.model,
            caller if keys.needed else None, asked.search,
        )  # fmt: skip
        rows = store.jobs(asked.limit + 1, asked.cursor, which, asked.sort)
        links = [Link(href="/jobs", rel="self")]
        if len(rows) > asked.limit:
            query = asked.model_dump(exclude_defaults=True) | {"limit": asked.limit}
            query["cursor"] = rows[asked.limit - 1].seq
            links.append(Link(href=f"/jobs?{urlencode(query, doseq=True)}", rel="next"))
        listed = [serializers.job_status(row) for row in rows[: asked.limit]]
        return JobList(jobs=listed, links=links)

    @api.patch(
        "/jobs/{job_id}", summary="Give a job another name, other tags", responses=unknown | unread
    )
    def label(caller: Caller, job_id: JobId, labels: LabelsIn) -> JobStatus:
        row = find(job_id, caller)
        store.label(job_id, labels.name, labels.tags)
        return serializers.job_status(find(job_id, caller), has_estimates(store, row))

    @api.get("/jobs/{job_id}", summary="Status", response_model=JobStatus, responses=unknown)
    def job(caller: Caller, http: HttpRequest, job_id: JobId) -> Response:
        row = find(job_id, caller)
        headers = {} if row.status in ENDED else {"Retry-After": "1"}
        status = serializers.job_status(row, has_estimates(store, row))
        return with_etag(http, status.model_dump_json().encode(), headers)

    @api.get(
        "/jobs/{job_id}/trace", summary="Every iteration", response_model=Trace, responses=unknown
    )
    def job_trace(
        caller: Caller,
        http: HttpRequest,
        job_id: JobId,
        after: Annotated[int, Query(ge=-1, le=2**31 - 1, description="only k > after")] = -1,
        points: Points = None,
        task: Annotated[int, Query(ge=0, le=2**31 - 1, description="of several starts")] = 0,
    ) -> Response:
        row = find(job_id, caller)
        if task >= (tasks := sum(json.loads(row.stages))):
            there = f"tasks 0 to {tasks - 1}" if tasks > 1 else "task 0 only"
            raise invalid("task", f"task = {task}; this job has {there}")
        ks, rows = store.rows(row.seq, task, after)
        names = parameter_names(store, row)
        if points is not None and len(ks) > points:
            kept = keep(rows[:, : len(names) + 1], points)
            ks, rows = [ks[i] for i in kept], rows[kept]
        return with_etag(http, serializers.trace(names, ks, rows).model_dump_json().encode())

    @api.get(
        "/jobs/{job_id}/request",
        summary="What was asked, with its data; it can be posted again",
        response_model=dict[str, Any],
        responses=unknown,
    )
    def asked(caller: Caller, http: HttpRequest, job_id: JobId) -> Response:
        body = store.document(find(job_id, caller).seq, "request")
        if body is None:
            raise Problem(404, "dismissed", f"job '{job_id}' was dismissed; its data are gone")
        return with_etag(http, body)

    @api.get(
        "/jobs/{job_id}/results",
        summary="Results, or why there are none",
        response_model=Results,
        responses=problem_answers(404, 422, 500),
    )
    def results(
        caller: Caller, http: HttpRequest, job_id: JobId, points: Points = None
    ) -> Response:
        row = find(job_id, caller)
        reached = None if has_estimates(store, row) else stopped_estimate(store, row)
        body = find_result(store, row) if reached is None else dumps(reached).encode()
        if points is not None:
            body = dumps(thin_results(json.loads(body), points)).encode()
        return with_etag(http, serializers.labelled(body, row))

    @api.post(
        "/jobs/{job_id}/stop",
        summary="Stop a job and keep what it has; one that has ended stays as it is",
        responses=unknown,
    )
    def stop(caller: Caller, job_id: JobId) -> JobStatus:
        find(job_id, caller)
        row = store.stop(job_id)
        return serializers.job_status(row, has_estimates(store, row))

    @api.delete(
        "/jobs/{job_id}",
        summary="Stop a job and keep what it has; remove the data of one that has ended",
        responses=unknown,
    )
    def dismiss(caller: Caller, job_id: JobId) -> JobStatus:
        find(job_id, caller)
        return serializers.job_status(store.dismiss(job_id))

    @api.post(
        "/jobs/{job_id}/resume",
        summary="Go on with a failed or stopped job from its checkpoint, or with more iterations",
        responses=unread | problem_answers(404, 409, 429),
    )
    def resume(caller: Caller, job_id: JobId, limit: ResumeIn | None = None) -> JobStatus:
        asked = limit or ResumeIn()
        check_resumed(find(job_id, caller), asked, settings.max_iterations)
        row = store.resume(job_id, limits(caller), asked.run_seconds, asked.iterations)
        supervisor.wake()
        return serializers.job_status(row)

    @api.get("/livez", summary="The process is alive")
    async def livez() -> dict[str, str]:
        return {"status": "alive"}

    @api.get("/readyz", summary="Store and runner can be used", responses=problem_answers(503))
    def readyz() -> dict[str, str]:
        if reason := supervisor.trouble():
            raise Problem(503, "not-ready", reason)
        return {"status": "ready"}

    @api.get("/metrics", summary="Prometheus metrics", response_class=PlainTextResponse)
    def prometheus(caller: Caller) -> Response:
        text = metrics.text(store, supervisor)
        return Response(text, media_type="text/plain; version=0.0.4; charset=utf-8")

    return api
