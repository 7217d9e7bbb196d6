"""What the page of a job shows: its report, and how far each of its computations is."""

import json
from datetime import UTC, datetime
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Response
from fastapi import Request as HttpRequest

from engine.errors import OptionError
from engine.presentation.report import OnPage, Report, make_report, report_html
from service.auth import Keys
from service.downsample import thin_results
from service.etags import with_etag
from service.lookup import find_job, find_result, parameter_names
from service.openapi import JobId, problem_answers
from service.pages import prefers_html
from service.problems import Problem, invalid
from service.responses import ChartsOut, ReportOut, ReportSection, TaskOut, Tasks
from service.serializers import labels
from service.stages import roles
from service.store import Store
from service.strict_json import finite

FILE_POINTS = 3000  # of a curve in a report as a file
From = Annotated[
    float, Query(alias="from", allow_inf_nan=False, description="time, in the unit of the record")
]
To = Annotated[float, Query(alias="to", allow_inf_nan=False, description="a later time")]
# A report has no script, loads nothing, and brings its own style.
FILE_POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"


def router(store: Store, keys: Keys) -> APIRouter:
    """The JSON calls behind the page."""
    api = APIRouter(responses=problem_answers(*keys.refusals, 422))
    Caller = Annotated[str, Depends(keys.dependency)]
    find = partial(find_job, store, keys)

    @api.get("/jobs/{job_id}/tasks", summary="Its computations", responses=problem_answers(404))
    def tasks(caller: Caller, job_id: JobId) -> Tasks:
        row = find(job_id, caller)
        names = parameter_names(store, row)
        return Tasks(tasks=_tasks(row, names, store))

    @api.get(
        "/jobs/{job_id}/report",
        summary="Its report: one HTML file, or its parts as JSON",
        response_model=ReportOut,
        responses=problem_answers(404, 500)
        | {200: {"content": {"text/html": {"schema": {"type": "string"}}}}},
    )
    def report(caller: Caller, http: HttpRequest, job_id: JobId) -> Response:
        row = find(job_id, caller)
        document = json.loads(find_result(store, row))
        if prefers_html(http.headers.get("Accept", "")):
            return _file(row, thin_results(document, FILE_POINTS))
        made, draw = _on_page(document)
        return report_parts(http, made, draw)

    @api.get(
        "/jobs/{job_id}/charts",
        summary="Long curves of its report between two times, with more of their points",
        responses=problem_answers(404, 500),
        response_model=ChartsOut,
    )
    def charts(caller: Caller, http: HttpRequest, job_id: JobId, low: From, high: To) -> Response:
        if not low < high:
            raise invalid("to", f"to = {high:g} is not after from = {low:g}")
        document = json.loads(find_result(store, find(job_id, caller)))
        _, draw = _on_page(document, (low, high))
        return with_etag(http, ChartsOut(charts=draw.finer).model_dump_json().encode())

    return api


def _on_page(
    document: dict[str, Any], zoom: tuple[float, float] | None = None
) -> tuple[Report, OnPage]:
    """The report's parts and its charts, numbered alike with any ``zoom``."""
    draw = OnPage(zoom)
    try:
        return make_report(document, draw), draw
    except OptionError as error:
        raise Problem(404, "no-report", str(error)) from None


def _tasks(row: Any, names: list[str], store: Store) -> list[TaskOut]:
    out, known = [], {task.task: (task, values) for task, values in store.tasks(row.seq)}
    for i, role in enumerate(roles(json.loads(row.stages))):
        if i not in known:  # of a stage that has not begun
            out.append(TaskOut(task=i, role=role, state="waiting"))
            continue
        task, values = known[i]
        one = TaskOut(
            task=i, role=role, state=task.state, iteration=task.iteration, restarts=task.losses
        )
        if values is not None and len(values) == len(names) + 4:
            numbers = [finite(v) for v in values.tolist()]
            one.estimate = dict(zip(names, numbers, strict=False))
            one.log_likelihood = numbers[len(names)]
        out.append(one)
    return out


def _file(row: Any, document: dict[str, Any]) -> Response:
    """The report as a file to keep. Raises Problem where there is nothing to report."""
    told = labels(row)
    about = {"name": told["name"], **{key: ", ".join(told[key]) for key in ("tags", "data")}}
    about |= {"job": row.id, "kind": row.kind, "model": row.model, "finished": _time(row.finished)}
    try:
        return report_file(report_html(document, about), f"{row.kind}-{row.id[:8]}.html")
    except OptionError as error:
        raise Problem(404, "no-report", str(error)) from None


def report_parts(http: HttpRequest, made: Report, draw: OnPage) -> Response:
    """A report in parts, for a page that draws its charts."""
    sections = [ReportSection(id=s.id, title=s.title, html=s.body) for s in made.sections]
    parts = ReportOut(title=made.title, summary=made.summary, sections=sections, charts=draw.charts)
    return with_etag(http, parts.model_dump_json().encode())


def report_file(text: str, name: str) -> Response:
    """A report as one HTML file."""
    headers = {
        "Content-Security-Policy": FILE_POLICY,
        "Content-Disposition": f'inline; filename="{name}"',
    }
    return Response(text, headers=headers, media_type="text/html")


def _time(seconds: float | None) -> str:
    if seconds is None:
        return ""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M UTC")
