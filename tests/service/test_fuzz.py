"""Schemathesis over the whole OpenAPI document: no answer is a 500, each is as documented."""

import copy
from contextlib import suppress

import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings
from hypothesis.errors import FlakyStrategyDefinition
from schemathesis import GenerationMode

from service.auth import digest_of
from service.settings import Settings

CALLS = [
    "GET /", "GET /models", "GET /models/{name}", "POST /models/extend", "POST /preview",
    "POST /jobs", "POST /jobs/upload", "GET /jobs", "GET /jobs/{job_id}", "PATCH /jobs/{job_id}",
    "GET /jobs/{job_id}/request",
    "GET /jobs/{job_id}/trace", "GET /jobs/{job_id}/results", "GET /jobs/{job_id}/tasks",
    "GET /jobs/{job_id}/report", "GET /jobs/{job_id}/charts", "GET /compare", "GET /compare/report",
    "DELETE /jobs/{job_id}", "POST /jobs/{job_id}/stop", "POST /jobs/{job_id}/resume", "GET /livez",
    "GET /readyz", "GET /metrics",
]  # fmt: skip
PLAIN = ("GET /", "GET /livez", "GET /readyz")  # nothing in them can be wrong
KEY = "the key of the fuzz test"


@pytest.fixture(scope="module")
def operations(serve, tmp_path_factory):
    small = {"max_samples": 50, "max_particles": 20, "max_iterations": 3, "max_tasks": 2}
    state = tmp_path_factory.mktemp("fuzz")
    (state / "keys").write_text(f"fuzz {digest_of(KEY)}\n")
    served = serve(
        Settings(
            state_dir=state,
            workers=1,
            max_queue=20,
            run_seconds=5.0,
            keys_file=state / "keys",
            **small,
        )
    )
    schema = schemathesis.openapi.from_url(f"http://127.0.0.1:{served.port}/openapi.json")
    found = [result.ok() for result in schema.get_all_operations()]
    yield {f"{one.method.upper()} {one.path}": one for one in found}
    served.stop()


@pytest.mark.long
def test_nothing_is_left_out(operations):
    assert set(operations) == set(CALLS)


THOROUGH = pytest.mark.parametrize("examples", [6, pytest.param(40, marks=pytest.mark.slow)])


@pytest.mark.long
@THOROUGH
@pytest.mark.parametrize(
    ("call", "mode"),
    [(c, mode) for c in CALLS for mode in GenerationMode if mode.is_positive or c not in PLAIN],
    ids=str,
)
def test_call(operations, call, mode, examples):
    operation = operations[call]
    # What is valid by the schema may name a model or a parameter that does not exist: 422.
    excluded = [schemathesis.checks.positive_data_acceptance]
    if call == "GET /jobs":  # query parameters that mean nothing are ignored
        excluded.append(schemathesis.checks.negative_data_rejection)

    @settings(
        max_examples=examples,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy(generation_mode=mode))
    def run(case):
        case.call_and_validate(
            headers={"X-API-Key": KEY},
            excluded_checks=excluded,
        )

    run()


SERIES = {"model": "local-level", "series": [{"y": [1.0, None, 2.0, 1.5, 0.5] * 8}]}
ACCEPTED = [
    SERIES | {"kind": "estimate", "options": {"iterations": 3, "particles": 10}},
    SERIES | {"kind": "smooth", "options": {"particles": 10}},
    {"kind": "simulate", "model": "linear-2", "options": {"samples": 10}},
]


@pytest.mark.long
def test_calls_one_after_the_other(operations):
    """What one call made, the next ones use: watched, stopped, resumed, removed, in any order."""
    asked, wrong = [], []

    class Workflow(operations["POST /jobs"].schema.as_state_machine()):
        def get_call_kwargs(self, case):
            return {"headers": {"X-API-Key": KEY}}

        def before_call(self, case):
            """Of generated jobs none would be accepted: they name no model that there is."""
            if case.operation.label == "POST /jobs":
                case.body = ACCEPTED[len(asked) % len(ACCEPTED)]
                case.headers, case.media_type = {}, "application/json"

        def after_call(self, response, case):
            asked.append((case.operation.label, response.status_code))

        def validate_response(self, response, case, additional_checks=(), **kwargs):
            excluded = [
                schemathesis.checks.positive_data_acceptance,
                schemathesis.checks.negative_data_rejection,
                schemathesis.checks.ensure_resource_availability,  # a job without results is a 404
                schemathesis.checks.use_after_free,  # what was removed has a status that says so
            ]
            try:
                case.validate_response(
                    response, additional_checks=additional_checks, excluded_checks=excluded,
                    headers={"X-API-Key": KEY},
                )  # fmt: skip
            except BaseException as error:
                wrong.append(error)
                raise

    with suppress(FlakyStrategyDefinition):  # a job is further when the same calls are made again
        Workflow.run(
            settings=settings(
                max_examples=15,
                stateful_step_count=8,
                deadline=None,
                derandomize=True,
                database=None,
                suppress_health_check=list(HealthCheck),
            )
        )
    if wrong:
        raise wrong[0]
    made = [label for label, status in asked if status == 201]
    of_jobs = {label for label, status in asked if "{job_id}" in label and status == 200}
    assert made
    assert of_jobs, "no call ever reached a job that another call had made"


KINDS = {
    "estimate": "EstimateRequest",
    "smooth": "SmoothRequest",
    "simulate": "SimulateRequest",
    "diagnose": "DiagnoseRequest",
    "design": "DesignRequest",
}


@pytest.mark.long
@THOROUGH
@pytest.mark.parametrize("mode", list(GenerationMode), ids=str)
@pytest.mark.parametrize("kind", KINDS)
def test_bodies_of_every_kind(operations, kind, mode, examples):
    """The same with POST /jobs narrowed to one kind, so that none is left out by chance."""
    whole = operations["POST /jobs"].schema
    raw = copy.deepcopy(whole.raw_schema)
    body = raw["paths"]["/jobs"]["post"]["requestBody"]["content"]["application/json"]
    body.pop("examples", None)
    named = {one["$ref"].rpartition("/")[2] for one in body["schema"]["oneOf"]}
    assert named == set(KINDS.values())
    body["schema"] = {"$ref": f"#/components/schemas/{KINDS[kind]}"}
    narrowed = schemathesis.openapi.from_dict(raw)
    narrowed.location = whole.location
    narrowed.config.update(base_url=whole.get_base_url())
    operation = narrowed["/jobs"]["POST"]
    seen = []

    @settings(
        max_examples=examples,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy(generation_mode=mode))
    def run(case):
        if isinstance(case.body, dict):
            seen.append(case.body.get("kind"))
        case.call_and_validate(
            headers={"X-API-Key": KEY},
            excluded_checks=[schemathesis.checks.positive_data_acceptance],
        )

    run()
    assert kind in seen
