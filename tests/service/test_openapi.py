"""The OpenAPI document describes the API, and its examples are requests the API accepts."""

import pytest

from service.examples import EXAMPLES


def test_document_lists_every_call(client):
    paths = client.get("/openapi.json").json()["paths"]
    calls = {(verb, path) for path, item in paths.items() for verb in item}
    assert {
        ("get", "/models"), ("get", "/models/{name}"), ("post", "/jobs"), ("get", "/jobs"),
        ("get", "/jobs/{job_id}"), ("delete", "/jobs/{job_id}"), ("get", "/jobs/{job_id}/trace"),
        ("get", "/jobs/{job_id}/results"), ("get", "/livez"),
    } <= calls  # fmt: skip


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_are_accepted_and_run_to_the_end(client, ended, name):
    operation = client.get("/openapi.json").json()["paths"]["/jobs"]["post"]
    example = operation["requestBody"]["content"]["application/json"]["examples"][name]["value"]
    answer = client.post("/jobs", json=example)
    assert answer.status_code == 201, answer.text
    assert ended(client, answer.headers["location"])["status"] == "successful"
