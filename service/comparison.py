"""Two jobs side by side: as JSON, as parts of a page, as a file."""

import json
from functools import partial
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Depends, Query, Response
from fastapi import Request as HttpRequest

from engine.errors import OptionError
from engine.presentation.report import OnPage, comparison_html, comparison_report
from engine.presentation.two_results import compare_results
from service.auth import Keys
from service.downsample import keep
from service.etags import with_etag
from service.job_pages import FILE_POINTS, report_file, report_parts
from service.lookup import find_job, find_result
from service.openapi import problem_answers
from service.pages import prefers_html
from service.problems import Problem
from service.responses import ComparisonOut, ReportOut
from service.serializers import job_status
from service.store import Store
from service.strict_json import dumps

JobA = Annotated[str, Query(max_length=64, description="`jobID` of one job")]
JobB = Annotated[str, Query(max_length=64, description="of the other")]


def router(store: Store, keys: Keys) -> APIRouter:
    """The JSON calls."""
    api = APIRouter(responses=problem_answers(*keys.refusals, 404, 422, 500))
    Caller = Annotated[str, Depends(keys.dependency)]
    find = partial(find_job, store, keys)

    def compared(caller: str, ids: tuple[str, str]) -> tuple[list[Any], dict[str, Any]]:
        rows = [find(job_id, caller) for job_id in ids]
        try:
            found = compare_results(*(json.loads(find_result(store, row)) for row in rows))
            return rows, _thinned(found, FILE_POINTS)
        except OptionError as error:
            raise Problem(422, "nothing-to-compare", str(error)) from None

    @api.get("/compare", summary="Two jobs side by side", response_model=ComparisonOut)
    def compare(caller: Caller, http: HttpRequest, a: JobA, b: JobB) -> Response:
        rows, found = compared(caller, (a, b))
        jobs = [job_status(row).model_dump() for row in rows]
        return with_etag(http, dumps({"jobs": jobs, **found}).encode())

    @api.get(
        "/compare/report",
        summary="The same as parts of a page, or as one HTML file",
        response_model=ReportOut,
        responses={200: {"content": {"text/html": {"schema": {"type": "string"}}}}},
    )
    def report(caller: Caller, http: HttpRequest, a: JobA, b: JobB) -> Response:
        rows, found = compared(caller, (a, b))
        names = _names(rows)
        if prefers_html(http.headers.get("Accept", "")):
            about = {name: f"job {row.id}" for name, row in zip(names, rows, strict=True)}
            text = comparison_html(found, names, about)
            return report_file(text, f"compare-{a[:8]}-{b[:8]}.html")
        draw = OnPage()
        return report_parts(http, comparison_report(found, names, draw), draw)

    return api


def _names(rows: list[Any]) -> list[str]:
    """What the jobs are called; their ids tell those apart that are called the same."""
    names = [row.name or f"{row.kind} {row.id[:8]}" for row in rows]
    if names[0] == names[1]:
        names = [f"{name} ({row.id[:8]})" for name, row in zip(names, rows, strict=True)]
    return names


def _thinned(found: dict[str, Any], points: int) -> dict[str, Any]:
    """With about so many points of each curve, extremes kept."""
    for one in found["curves"]:
        curves = [one["t"], *one["measured"], *one["values"]]
        if len(one["t"]) > points:
            there = [curve for curve in curves[1:] if curve]
            rows = keep(np.array(there, dtype=float).T, points).tolist()
            curves = [curve and [curve[i] for i in rows] for curve in curves]
        one["t"], one["measured"], one["values"] = curves[0], curves[1:3], curves[3:]
    return found
